"""Truth beside a log: one row a second, CSV."""

from __future__ import annotations

import csv
from pathlib import Path

from yieldmon.files.whole_file import scratch_for
from yieldmon.plant.combine import TRUTH_COLUMNS, Truth


def write_csv(path: Path | str, truth: Truth) -> None:
    """Write the columns TRUTH_COLUMNS with 9 significant digits. Raises InputError or OSError as `whole_file.scratch_for`."""
    with scratch_for(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS)
        for row in zip(*(truth.columns[name] for name in TRUTH_COLUMNS), strict=True):
            writer.writerow([f"{value:.9g}" for value in row])
