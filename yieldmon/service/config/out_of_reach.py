"""Quantities whose signal, as it is mapped, can give no value with which a flow is measured, or whose constant is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import degrees
from typing import Any, NamedTuple

from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import QUANTITIES
from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, Machine
from yieldmon.signals.binding import IMPACT, Binding
from yieldmon.signals.extraction import Extraction
from yieldmon.signals.mapping import SignalMap
from yieldmon.signals.reach import reaches, values_in_reach, without_range

ANGLE_MARGIN_DEG = 5.0
"""Beyond the machine's range, for a park position and a rough zero of the angle."""
_ROUNDING = 1e-6
_LOOK_AT = {"elevator_speed": "unit, scale, offset, ratio and pulses_per_turn"}


class _Use(NamedTuple):
    """Which values of a quantity serve, and how that is said."""

    usable: Callable[[Any], Any]
    said: str


def out_of_reach(mapping: SignalMap, engine: EngineSettings, machine: Machine) -> Iterator[InputError]:
    """What is wrong with each quantity of which no value that its signal can give, or no constant, is of use.

    Parameters
    ----------
    mapping : SignalMap
    engine : EngineSettings
        Which voltages are possible, and from which force on grain is present.
    machine : Machine
        Speeds and angles at which flow is measured, and the cell.

    Yields
    ------
    InputError
        One line for each.
    """
    found = {name: extraction for group in mapping.groups for name, extraction in group.signals.items()}
    counted = {pulses.signal for group in mapping.groups for pulses in group.pulses}
    impact = [binding for binding in mapping.bindings if binding.is_impact]
    for number, binding in enumerate(impact):
        samples = [found[f"impact{number}.{index}"] for index in range(len(binding.signals))]
        problem = _of_impact(binding, samples, engine, machine, sensors=len(impact))
        if problem is not None:
            yield problem
    for binding in mapping.bindings:
        if binding.value is not None and binding.quantity == "elevator_speed":
            use, rpm = _use(binding.quantity, machine), mapping.sources.fixed[binding.quantity]
            if not use.usable(rpm):
                yield binding.refuse("value", f"{rpm:g}", f"{use.said}: no flow is measured at others")
        if binding.is_impact or binding.value is not None or binding.quantity in counted:
            continue
        problem = _unless(binding, found[binding.quantity], _use(binding.quantity, machine))
        if problem is not None:
            yield problem


def _use(quantity: str, machine: Machine) -> _Use:
    if quantity == "elevator_speed":
        low, high = machine.min_elevator_speed_rad_s / RPM, machine.max_elevator_speed_rad_s / RPM
        said = f"{low:.0f} to {high:.0f} rpm of the upper shaft, as the machine file says"
        return _Use(lambda rpm: (rpm >= low - _ROUNDING) & (rpm <= high + _ROUNDING), said)
    if quantity == "plate_angle":
        least, most = degrees(machine.min_plate_angle_rad), degrees(machine.max_plate_angle_rad)
        said = f"{least:g} to {most:g} deg, as the machine file says"
        return _Use(lambda deg: (deg >= least - ANGLE_MARGIN_DEG) & (deg <= most + ANGLE_MARGIN_DEG), said)
    known = QUANTITIES[quantity]
    return _Use(known.usable, f"what {quantity} can be ({', '.join(filter(None, (known.unit, known.meaning)))})")


def _unless(binding: Binding, extraction: Extraction, use: _Use, into: float = 1.0) -> InputError | None:
    """The error of a signal none of whose values is of use. into: from the quantity's unit into that of the values."""
    if reaches(extraction, use.usable):
        return None
    if binding.low is not None and reaches(without_range(extraction), use.usable):
        return binding.refuse("range", f"[{binding.low:g}, {binding.high:g}] admits no usable value", use.said)
    values = values_in_reach(without_range(extraction)) / into
    unit = IMPACT[binding.quantity] if binding.is_impact else QUANTITIES[binding.quantity].unit
    ends = " to ".join(f"{end:.6g}" for end in dict.fromkeys((values.min(), values.max()))) if values.size else "no value"
    look_at = _LOOK_AT.get(binding.quantity, "unit, scale and offset")
    return binding.refuse(
        "signal", f"{' and '.join(binding.signals)} as mapped can say {ends} {unit}".rstrip(), f"{use.said}; look at {look_at}"
    )


def _of_impact(
    binding: Binding, samples: list[Extraction], engine: EngineSettings, machine: Machine, *, sensors: int
) -> InputError | None:
    """Of a sensor whose samples are all impossible or at the end of the cell's range, or too coarse to tell grain from none."""
    cell, gate = machine.sensor, engine.gate
    into = 1.0 / cell.gain_n_per_mv if binding.quantity == "impact_force" else 1.0
    full_mv, least_mv = cell.full_scale_mv, -engine.windows.plausible_full_scales * cell.full_scale_mv
    span_mv = gate.grain_on_n / cell.gain_n_per_mv / sensors

    def usable(values: Any) -> Any:
        inside = values[(values >= least_mv) & (values < full_mv)]
        return inside.size > 0 and inside.max() - inside.min() >= span_mv

    said = (
        f"samples within {-full_mv / into:.6g} to {full_mv / into:.6g} {IMPACT[binding.quantity]}, the cell of the machine file, "
        f"and apart by {span_mv / into:.3g} {IMPACT[binding.quantity]} or more"
    )
    problems = (_unless(binding, extraction, _Use(usable, said), into) for extraction in samples)
    return next((problem for problem in problems if problem is not None), None)
