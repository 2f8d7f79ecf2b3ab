"""The lock file pins, with hashes, what pyproject.toml asks for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_dependency_is_pinned_with_hashes():
    entries = re.split(r"\n(?=\S)", (ROOT / "requirements.lock").read_text())
    pinned = {}
    for entry in entries:
        match = re.match(r"([a-z0-9-]+)==(\S+)", entry)
        if match:
            pinned[match[1]] = re.findall(r"--hash=sha256:[0-9a-f]{64}", entry)
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    names = {re.match(r"[A-Za-z0-9-]+", line)[0].lower() for line in declared}
    assert names <= set(pinned)
    assert all(pinned.values())
