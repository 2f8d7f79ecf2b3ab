"""The alarm when weighed masses contradict the calibration, which alone can show an error of scale.

A sweep cannot separate flow, density and impact gain, so chain slip, wear or a wrong gain show only in a weighed mass. It is
compared with the mass of the same grain by the parameters in use. The first mass that they cannot explain raises the alarm; the
next that agrees with them, or a calibration from outside, ends it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import erfc, hypot, isfinite, sqrt
from typing import Any

from yieldmon import utc
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.settings import FaultSettings

_CHECK = "check ticket, chain slip, paddle wear, sensor gain"
_CHANGED = (
    "the second in a row that is off this way: `yieldmon calibrations restart` if chain, paddles, sensor, amplifier or plate "
    f"were changed, else {_CHECK}"
)


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """A weighed mass and the measured mass of the same grain.

    Attributes
    ----------
    name : str
        Load or weighing, for the operator.
    start_s : float
        Bus time at which its grain began to pass, s.
    weighed_kg, measured_kg : float
        By the scale, and by the parameters in use, kg.
    std_dev_kg : float
        Of their difference, kg: scale, parameters, model, noise, zero and moisture.
    """

    name: str
    start_s: float
    weighed_kg: float
    measured_kg: float
    std_dev_kg: float

    @property
    def p_value(self) -> float:
        """Probability of so large a difference where the calibration holds."""
        return erfc(abs(self.measured_kg - self.weighed_kg) / (self.std_dev_kg * sqrt(2.0)))

    @property
    def error_pct(self) -> float:
        """Relative error of the measured mass, %."""
        return 100.0 * (self.measured_kg / self.weighed_kg - 1.0)

    @property
    def error_std_dev_pct(self) -> float:
        """Standard deviation of `error_pct`."""
        return 100.0 * self.std_dev_kg / self.weighed_kg


def name_of_load(number: int) -> str:
    """Name of a weighed load, by which its ticket is known."""
    return f"load {number}"


def name_of(mass: ReferenceMass) -> str:
    """Name of a load by its number, of another weighing by source, mass and time: a coarse scale repeats the same increment."""
    if mass.load_number:
        return name_of_load(mass.load_number)
    return f"the {mass.source}'s {mass.reference_kg:.0f} kg of {_moment(mass.end_s)}"


def as_stated(mass: ReferenceMass) -> ScaleCheck | None:
    """Compare a mass with the counted one; None where it was not measured completely."""
    if not mass.complete or not mass.measured_kg > 0.0:
        return None
    known = mass.budget.std_dev_kg
    std_dev_kg = hypot(mass.std_dev_kg, known if isfinite(known) else 0.0)
    return ScaleCheck(name_of(mass), mass.start_s, mass.reference_kg, mass.measured_kg, std_dev_kg)


@dataclass(frozen=True, slots=True)
class ScaleAlarmState:
    """State of the alarm over a restart.

    contradiction: the newest contradicting mass; None: no alarm. since_s, since: bus time, s, at which the grain of the first
    contradicting mass began to pass, and its name. agreed: name of the newest mass that agreed, "" for none. same_way: successive
    masses that contradict in the same direction, each after an update by those before it.
    """

    contradiction: ScaleCheck | None = None
    since_s: float = 0.0
    since: str = ""
    agreed: str = ""
    same_way: int = 1

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ScaleAlarmState:
        """Inverse of `dataclasses.asdict`. Raises TypeError."""
        check = data.get("contradiction")
        return cls(**{**data, "contradiction": None if check is None else ScaleCheck(**check)})


class ScaleAlarm:
    """Raises and ends the alarm."""

    def __init__(self, settings: FaultSettings) -> None:
        self._settings = settings
        self._state = ScaleAlarmState()

    @property
    def state(self) -> ScaleAlarmState:
        """State to keep for a restart."""
        return self._state

    def restore(self, state: ScaleAlarmState) -> None:
        """Continue from a stored state."""
        self._state = state

    def see(self, checks: Sequence[ScaleCheck]) -> None:
        """Take masses weighed since the last call, each compared with the parameters before its update."""
        for check in checks:
            state, p_value = self._state, check.p_value
            again = state.contradiction if state.contradiction is not None and state.contradiction.name == check.name else None
            if again is not None:
                # Entered anew: the parameters before the wrong mass decide, not those that it led to.
                before = replace(check, measured_kg=again.measured_kg, std_dev_kg=again.std_dev_kg)
                p_value = max(p_value, before.p_value)
            if p_value >= self._settings.scale_agrees_p:
                self._state = ScaleAlarmState(agreed=check.name)
            elif again is not None:
                self._state = replace(state, contradiction=before)
            elif p_value < self._settings.scale_disagrees_p:
                last, same_way = state.contradiction, 1
                if last is None:
                    state = ScaleAlarmState(None, check.start_s, check.name, state.agreed)
                elif (check.error_pct > 0.0) == (last.error_pct > 0.0):
                    same_way = state.same_way + 1
                self._state = ScaleAlarmState(check, state.since_s, state.since, state.agreed, same_way)

    def accept(self) -> None:
        """End the alarm: other parameters have come from outside."""
        self._state = ScaleAlarmState()

    @property
    def detail(self) -> str | None:
        """Size and begin of the contradiction, for the operator; None without an alarm."""
        state, check = self._state, self._state.contradiction
        if check is None:
            return None
        agreed = f"; {state.agreed} still agreed" if state.agreed else ""
        begin = _moment(state.since_s)
        first = f"from {begin} on" if state.since == check.name else f"since {state.since} ({begin})"
        return (
            f"scale: {check.name} weighed {check.weighed_kg:.0f} kg, measured {check.measured_kg:.0f} kg: "
            f"{check.error_pct:+.1f} +- {check.error_std_dev_pct:.1f} % (p {_probability(check.p_value)}), {first}{agreed}; "
            f"{_CHANGED if state.same_way > 1 else _CHECK}"
        )


def _probability(p_value: float) -> str:
    return f"{p_value:.0e}" if p_value > 1e-12 else "< 1e-12"


def _moment(time_s: float) -> str:
    if not isfinite(time_s) or time_s < utc.EARLIEST_BUS_TIME_S:
        return f"bus time {time_s:.0f} s"
    return utc.moment(time_s).strftime("%Y-%m-%d %H:%M UTC")
