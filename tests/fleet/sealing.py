"""Marks of days that a test has changed the tables of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from yieldmon.files import digests
from yieldmon.fleet.dataset_files import MARK


def seal(day: Path, **changes: Any) -> None:
    """Write a day's mark for the tables that are there; changes: of its other entries."""
    mark = day / MARK
    content = json.loads(mark.read_text()) if mark.exists() else {"key": "k", "poisoned": []}
    paths = sorted(day.glob("*.parquet"))
    files = {path.name: {"bytes": path.stat().st_size, "sha256": digests.of_file(path)} for path in paths}
    mark.write_text(json.dumps({**content, **changes, "files": files}))
