"""Time of a load that was not measured although grain may have come in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

from yieldmon.engine.mass.silences import Missing, Silences
from yieldmon.engine.settings import EngineSettings
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import RPM, Machine
from yieldmon.service.storage.rows import SecondRow

_GAP_S = 0.5
"""Time without a second that a load may lack altogether, since seconds begin and end with their frames."""
_SECOND_UNDER_WAY_S = 2.0
"""From the last second of a load to its end: the second in which it ends is of the next load."""


@dataclass(frozen=True, slots=True)
class Unmeasured:
    """Of one load.

    Attributes
    ----------
    seconds_s : float
        Of seconds, and of longer times without one, that lack an input, s.
    gaps_s : float
        Of short times between seconds, s.
    """

    seconds_s: float
    gaps_s: float

    @property
    def none(self) -> bool:
        """Whether every second was measured."""
        return self.seconds_s == 0.0 and self.gaps_s <= _GAP_S


def is_available(second: SecondRow) -> bool:
    """Whether a second has a flow or is known to be without grain."""
    return second.mass_flow_kg_s is not None or second.quality != EstimateQuality.NOT_AVAILABLE


def unmeasured(
    seconds: Sequence[SecondRow],
    machine: Machine,
    settings: EngineSettings,
    *,
    started_s: float | None = None,
    ended_s: float | None = None,
) -> Unmeasured:
    """What a load lacks.

    Parameters
    ----------
    seconds : sequence of SecondRow
        All of the load's, in order, one or more.
    machine : Machine
    settings : EngineSettings
    started_s, ended_s : float, optional
        Of the load, Unix time; None where not known, and of one that goes on.

    Returns
    -------
    Unmeasured
        None of it in silences in which no grain comes (`engine.mass.silences`).
    """
    silences, lacking_s = Silences(), 0.0
    end_s = seconds[0].time_s - seconds[0].duration_s
    gaps_s = 0.0 if started_s is None else max(0.0, end_s - started_s)
    for second in seconds:
        gap_s = max(0.0, second.time_s - second.duration_s - end_s)
        if gap_s <= _GAP_S:
            gaps_s += gap_s
        elif not silences.lacks_nothing(gap_s, Missing.ALL):
            lacking_s += gap_s
        end_s = second.time_s
        speed_rpm = nan if second.elevator_speed_rpm is None else second.elevator_speed_rpm
        missing = Missing.of(
            sampled=second.coverage > 0.0,
            speed=speed_rpm,
            in_range=machine.min_elevator_speed_rad_s <= speed_rpm * RPM <= machine.max_elevator_speed_rad_s,
            zeroed=second.zero_mv is not None,
        )
        stands = speed_rpm <= settings.gate.min_turning_rpm
        if not silences.lacks_nothing(second.duration_s, None if is_available(second) else missing, stands=stands):
            lacking_s += second.duration_s
    unseen_s = 0.0 if ended_s is None else ended_s - end_s
    if unseen_s > _SECOND_UNDER_WAY_S and not silences.lacks_nothing(unseen_s, Missing.ALL):
        lacking_s += unseen_s
    return Unmeasured(lacking_s, gaps_s)
