"""Pictures of the page for the documentation: `python -m tests.web.screenshots` writes docs/img/web-*.png."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from tests.web.browser import CAB, OFFICE, Watched, chromium, opened
from tests.web.standin import StandIn, fault, page, standing_in
from yieldmon.files import parameter_file
from yieldmon.service.storage.batch import FaultEvent, Load, ParameterVersion, SweepRecord

PICTURES = Path(__file__).parents[2] / "docs" / "img"
START_S = 1_760_083_200.0
"""2025-10-10 08:00 UTC"""


ANGLES_DEG = [60.0, 65.0, 70.0]


def harvest(daemon: StandIn) -> None:
    """Two hours of a morning, with the day before, and what a season leaves in a store."""
    daemon.seconds(7200)
    loads = tuple(
        Load(number, "north", "corn", START_S + 1500 * (number - 1), START_S + 1500 * number, 10_400.0 + 40 * number, None)
        for number in range(1, 5)
    )
    known = parameter_file.load()
    versions = []
    for number in range(1, 6):
        moved = replace(known, values={**known.values, "friction": known.values["friction"] * (1.0 - 0.01 * number)})
        document = parameter_file.to_document(moved)
        versions.append(ParameterVersion(number, START_S + 1400 * number, "file" if number == 1 else "sweep", document))
    sweeps = tuple(
        SweepRecord(START_S + 1400 * number, "updated", "friction moved", {"angles_deg": ANGLES_DEG, "parameter_version": number})
        for number in range(2, 6)
    )  # fmt: skip
    faults = (FaultEvent(START_S + 3000.0, "FramesLost", True, "3 frames"), FaultEvent(START_S + 3005.0, "FramesLost", False))
    daemon.commit(loads=loads, parameter_versions=tuple(versions), sweeps=sweeps, faults=faults)
    daemon.faults = [
        fault("MoistureMissing") | {
            "severity": "warning", "effect": "Dry mass is not known.", "remedy": "Check the moisture sensor and its wiring."
        }
    ]  # fmt: skip


def main(folder: Path = PICTURES) -> int:
    """Exit code 0 when all pictures are written."""
    if chromium() is None:
        print("no chromium; on Debian: apt-get install chromium", file=sys.stderr)
        return 1
    os.environ["TZ"] = "UTC"
    time.tzset()
    with (
        tempfile.TemporaryDirectory() as scratch,
        standing_in(Path(scratch), start_s=START_S) as daemon,
        page(daemon.socket) as url,
        opened() as browser,
    ):  # fmt: skip
        harvest(daemon)
        for size in (CAB, OFFICE):
            for name, path in (("live", "/"), ("history", "/history")):
                with Watched(browser, size) as watched:
                    watched.page.goto(url + path)
                    watched.wait("document.querySelector('canvas[data-points]')?.dataset.points > 1000")
                    watched.page.wait_for_timeout(500)
                    picture = folder / f"web-{name}-{size['width']}x{size['height']}.png"
                    watched.page.screenshot(path=picture)
                    print(f"made {picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
