"""What a record's seconds lack, seen as they pass: gaps, seconds that come twice, inputs that are not there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

from yieldmon.documents.process import ProcessSummary
from yieldmon.engine.faults import FaultCode
from yieldmon.service.storage.rows import SecondRow
from yieldmon.utc import EARLIEST_BUS_TIME_S

_BACK_S = 0.5
"""Further back than this is the clock or another log."""
_GAP_S = 0.5
"""Between one second's end and the next one's begin; more is a gap."""
_SPEED = "elevator_speed_rpm"
_INPUTS = {
    "moisture_pct": "moisture",
    "latitude_deg": "position",
    "ground_speed_m_s": "ground speed",
    _SPEED: "elevator speed",
    "plate_angle_deg": "plate angle",
}


@dataclass
class RecordCheck:
    """Counts over the seconds taken so far.

    pulse_limit_mv: larger pulses are grain before any zero is known; home_deg: least and largest angle of a plate at home.
    seconds: those with samples; gaps: stretches without; before_zero: seconds of grain before the first zero, which have no
    mass; away: seconds with the plate elsewhere than at home.
    """

    pulse_limit_mv: float = inf
    home_deg: tuple[float, float] = (-inf, inf)
    seconds: int = 0
    before_zero: int = 0
    away: int = 0
    gaps: int = 0
    gap_s: float = 0.0
    overlap_s: float = 0.0
    overlap_kg: float = 0.0
    _frames_lost: int = 0
    _stretch: tuple[float, float] | None = None
    """Begin and end of that under way, in which time went on."""
    _before: list[tuple[float, float]] = field(default_factory=list)
    """Of those before it, joined where they touch."""
    _silent: bool = False
    _lacking_s: float = 0.0
    """Of the second before, not silent: what it lacks of samples."""
    _unknown: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_INPUTS, 0))

    def take(self, row: SecondRow) -> None:
        """The next second."""
        silent = not row.coverage > 0.0
        lacking_s = (1.0 - row.coverage) * row.duration_s
        before_s = self._stretch[1] if self._stretch is not None else row.time_s
        # Where a recorder gets the date in the middle nothing is left out.
        dated = before_s < EARLIEST_BUS_TIME_S <= row.time_s
        jumped = row.time_s - before_s > row.duration_s + _GAP_S and not dated
        if jumped:
            self.gap_s += row.time_s - before_s - row.duration_s
        # Silence seldom begins and ends with a second: the ones about it lack the rest.
        if silent:
            self.gap_s += row.duration_s + self._lacking_s
        elif self._silent:
            self.gap_s += lacking_s
        self._lacking_s = 0.0 if silent or self._silent else lacking_s
        self.gaps += jumped or (silent and not self._silent)
        self._silent = silent
        if self._comes_again(row):
            self.overlap_s += row.duration_s
            self.overlap_kg += row.mass_kg
        if silent:
            return
        self.seconds += 1
        self.before_zero += row.zero_mv is None and row.pulse_mv is not None and row.pulse_mv > self.pulse_limit_mv
        angle_deg = row.plate_angle_deg
        self.away += angle_deg is not None and not self.home_deg[0] <= angle_deg <= self.home_deg[1]
        self._frames_lost += FaultCode.FRAMES_LOST in (row.faults or "").split()
        for name in _INPUTS:
            # In stores and tables of version 0.1.0 such a second has the nominal speed.
            unknown = name == _SPEED and FaultCode.SPEED_MISSING in (row.faults or "").split()
            self._unknown[name] += unknown or getattr(row, name) is None

    def _comes_again(self, row: SecondRow) -> bool:
        """Whether a second lies within a stretch before this one. A clock that begins anew, as one of 32 bits of microseconds
        does, goes back to times that nothing was read of."""
        began_s, middle_s = row.time_s - row.duration_s, row.time_s - 0.5 * row.duration_s
        if self._stretch is None:
            self._stretch = began_s, row.time_s
        elif row.time_s <= self._stretch[1] - _BACK_S:
            self._before = _joined([*self._before, self._stretch])
            self._stretch = began_s, row.time_s
        else:
            self._stretch = self._stretch[0], max(self._stretch[1], row.time_s)
        return any(first_s <= middle_s <= last_s for first_s, last_s in self._before)

    @property
    def frames_lost_share(self) -> float:
        """Of the seconds with samples, those under FramesLost."""
        return self._frames_lost / self.seconds if self.seconds else 0.0

    @property
    def away_share(self) -> float:
        """Of the seconds with samples, those with the plate elsewhere than at home."""
        return self.away / self.seconds if self.seconds else 0.0

    @property
    def missing(self) -> dict[str, float]:
        """Input -> share of the seconds without it, where it is missing at all."""
        return {said: self._unknown[name] / self.seconds for name, said in _INPUTS.items() if self._unknown[name]}


def _joined(stretches: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The same times, one stretch where several touch."""
    found: list[tuple[float, float]] = []
    for first_s, last_s in sorted(stretches):
        if found and first_s <= found[-1][1] + _GAP_S:
            found[-1] = found[-1][0], max(found[-1][1], last_s)
        else:
            found.append((first_s, last_s))
    return found


#: What to do with a file in which two logs were joined.
SEPARATE_FILES = "logs of two loggers count once if they are given as separate files"


def same_times_line(pairs: Sequence[tuple[str, str]]) -> str:
    """What logs may be that have different frames at the same times; pairs: a log and one before it."""
    (log, other), more = pairs[0], f" (and {len(pairs) - 1} more pairs)" if len(pairs) > 1 else ""
    return (
        f"{log} and {other}{more} have different frames at the same times, as of two machines, or of a clock that was set wrong; "
        "measure each machine's logs separately"
    )


def record_lines(document: ProcessSummary) -> list[str]:
    """What is to be said of a record's gaps, overlaps and missing inputs."""
    out = []
    if document.get("gaps"):
        out.append(f"gaps: {document['gaps']}, {document['gap_s']:.0f} s in all without samples")
    if document.get("overlap_s"):
        overlap = f"overlap: {document['overlap_s']:.0f} s with {document['overlap_kg']:.1f} kg"
        found = f"{overlap} lie before seconds that were read already"
        if same_times := document.get("same_times"):
            out.append(f"{found}, and count as well: {same_times_line([(e['log'], e['other']) for e in same_times])}")
        else:
            out.append(
                f"{found}: the clock was set back, or logs that overlap were joined into one file, which counts their mass "
                f"twice; {SEPARATE_FILES}"
            )
    if document.get("contested_kg"):
        out.append(
            f"contested: {document['contested_kg']:.1f} kg are in no total: more frames came than one node sends; two nodes or "
            f"channels send them, or the log has them twice; {SEPARATE_FILES}"
        )
    if document.get("before_zero_s"):
        out.append(f"before the first zero: {document['before_zero_s']} s of grain have no mass; --zero-mv gives a known zero")
    if document.get("missing"):
        shares = (f"{name} in {100.0 * share:.0f} % of the seconds" for name, share in document["missing"].items())
        out.append("missing: " + ", ".join(shares))
    return out
