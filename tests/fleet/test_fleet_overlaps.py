"""Seconds that several logs of a machine hold, against a count over all pairs of seconds."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.fleet.sealing import seal
from yieldmon.fleet import tables
from yieldmon.fleet.overlaps import Overlap, Overlaps, overlaps
from yieldmon.fleet.querying import opened

Log = tuple[str, list[tuple[float, float, float]]]
"""Name, and end, duration and mass of each second."""


def day(dataset: Path, name: str, logs: list[Log]) -> None:
    """A partition of machine m with these logs."""
    folder = dataset / "machine=m" / f"day={name}"
    folder.mkdir(parents=True)
    seconds = [second for _, found in logs for second in found]
    columns = dict(zip(("time_s", "duration_s", "mass_kg"), map(list, zip(*seconds, strict=True)), strict=True))
    pq.write_table(pa.table({"number": list(range(1, len(seconds) + 1)), **columns}), folder / "records.parquet")
    rows: list[dict[str, Any]] = []
    for log, found in logs:
        first = rows[-1]["last_number"] + 1 if rows else 1
        ends = [end for end, *_ in found]
        rows.append({
            "kind": tables.LOG, "name": log, "first_number": first, "last_number": first + len(found) - 1,
            "start_s": min(ends) - 1.0, "end_s": max(ends), "seconds": len(found), "measured_kg": 0.0,
        })  # fmt: skip
    tables.write(tables.LOADS, rows, folder / "loads.parquet")
    seal(folder)


def drawn(rng: np.random.Generator, begin_s: float) -> list[tuple[float, float, float]]:
    """Seconds of which some are missing, some hold no grain, and some are out of order as after a step of the clock."""
    ends = begin_s + np.arange(1, 41) + rng.uniform(0.0, 0.3)
    kept = ends[rng.random(ends.size) < 0.8]
    kept[5:8] = kept[5:8][::-1].copy()
    masses = np.where(rng.random(kept.size) < 0.3, 0.0, rng.uniform(1.0, 20.0, kept.size))
    return [(float(end), 1.0, float(mass)) for end, mass in zip(kept, masses, strict=True)]


BEGINS = {"d1": (0.0, 15.0, 200.0), "d2": (20.0,), "d3": (210.0, 500.0), "d4": (1000.0,)}
"""Of each day's logs."""


def drawn_days(dataset: Path, seed: int, epoch_s: float) -> dict[str, list[Log]]:
    rng = np.random.default_rng([190, seed])
    days = {name: [(f"{k}.log", drawn(rng, epoch_s + begin)) for k, begin in enumerate(found)] for name, found in BEGINS.items()}
    for name, found in days.items():
        day(dataset, name, found)
    return days


def by_all_pairs(days: dict[str, list[Log]]) -> list[Overlap]:
    logs = [(name, *log) for name, found in sorted(days.items()) for log in found]
    found = []
    for (day_a, log_a, ours), (day_b, log_b, theirs) in combinations(logs, 2):
        again, met = [
            [s for s in some if any(end - d < s[0] - 0.5 * s[1] <= end for end, d, _ in others)]
            for some, others in ((theirs, ours), (ours, theirs))
        ]
        mass_kg = sum(mass for *_, mass in again)
        if mass_kg > 0.0 and sum(mass for *_, mass in met) > 0.0:
            found.append(Overlap("m", day_b, log_b, day_a, log_a, len(again), mass_kg))
    return found


def again_by_all_pairs(days: dict[str, list[Log]], pairs: list[Overlap]) -> dict[tuple[str, str, str], float]:
    """Of each log the mass that logs before it have too, a second once."""
    logs = {(name, log): seconds for name, found in days.items() for log, seconds in found}
    found: dict[tuple[str, str, str], float] = {}
    for where in dict.fromkeys((pair.day, pair.log) for pair in pairs):
        before = [logs[o.other_day, o.other_log] for o in pairs if (o.day, o.log) == where]
        middles = [(end - 0.5 * duration, mass) for end, duration, mass in logs[where]]
        again = [m for t, m in middles if any(end - d < t <= end for seconds in before for end, d, _ in seconds)]
        found["m", *where] = sum(again)
    return found


def test_a_time_that_three_logs_have_counts_once(tmp_path: Path) -> None:
    seconds = [(1.7e9 + second, 1.0, 5.0) for second in range(1, 11)]
    day(tmp_path, "d10", [("a.log", seconds), ("b.log", seconds[5:])])
    day(tmp_path, "d9", [("c.log", [*seconds[3:], (1.7e9 + 11.0, 1.0, 5.0)])])
    with opened(str(tmp_path), (tables.LOADS,)) as query:
        assert overlaps(query).again_kg == {("m", "d10", "b.log"): 25.0, ("m", "d9", "c.log"): 35.0}
        assert overlaps(query, {("m", "d9"): 0, ("m", "d10"): 1}).again_kg == {
            ("m", "d10", "a.log"): 35.0,
            ("m", "d10", "b.log"): 25.0,
        }


@pytest.mark.parametrize("seed", range(6))
def test_overlaps_are_those_of_all_pairs_of_seconds(seed: int, tmp_path: Path) -> None:
    days = drawn_days(tmp_path, seed, 1.7e9)
    with opened(str(tmp_path), (tables.LOADS,)) as query:
        found = overlaps(query)
    said, expected = found.pairs, by_all_pairs(days)
    assert {(o.day, o.other_day) for o in expected} == {("d1", "d1"), ("d2", "d1"), ("d3", "d1")}
    assert [(o.day, o.log, o.other_day, o.other_log, o.seconds) for o in said] == [
        (o.day, o.log, o.other_day, o.other_log, o.seconds) for o in expected
    ]
    assert [o.mass_kg for o in said] == pytest.approx([o.mass_kg for o in expected])
    assert found.again_kg == pytest.approx(again_by_all_pairs(days, expected))


def test_times_that_are_no_dates_say_nothing_of_one_another(tmp_path: Path) -> None:
    """As those of .asc files, which begin at 0 each."""
    drawn_days(tmp_path, 0, 0.0)
    with opened(str(tmp_path), (tables.LOADS,)) as query:
        assert overlaps(query) == Overlaps((), {})
