"""What an operator should know of a mapping before it is used."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

import numpy as np

from yieldmon.engine.sampling.aliasing import ALIAS_FREE_HZ, aliasing_share
from yieldmon.engine.sources import QUANTITIES, SampleSource
from yieldmon.physics.machine import RPM, Machine
from yieldmon.service.config.configuration import Configuration
from yieldmon.signals.binding import IMPACT, Binding
from yieldmon.signals.extraction import Extraction
from yieldmon.signals.packing import Packing, span
from yieldmon.signals.published import PUBLISHED
from yieldmon.signals.state_names import codes_by_name
from yieldmon.signals.units import factor, may_be, zero

SPEEDS_RPM = (300.0, 400.0, 500.0)
_WORTH_SAYING_PCT = 0.1
_SPEED_BAND = np.linspace(0.98, 1.02, 9)
"""A loaded elevator turns up to this share off its stated speed: enough to fold a harmonic onto 0."""
_FORCES_N = np.geomspace(5.0, 500.0, 24)


def aliasing_pct(configuration: Configuration) -> dict[str, float]:
    """Largest standard deviation of a second's flow from aliasing, %, near each elevator speed; empty where there is none."""
    sources = [source for source in configuration.signals.sources.impact if source.rate_hz < ALIAS_FREE_HZ]
    found = {f"{rpm:g}": 100.0 * _largest_share(sources, configuration.machine, rpm * RPM) for rpm in SPEEDS_RPM}
    if max(found.values()) < _WORTH_SAYING_PCT:
        return {}
    return {rpm: round(share * _flow_per_force(configuration, float(rpm) * RPM), 2) for rpm, share in found.items()}


def _largest_share(sources: Sequence[SampleSource], machine: Machine, speed_rad_s: float) -> float:
    """Of the mean force, for speeds of the band."""
    speeds = (float(speed) for speed in speed_rad_s * _SPEED_BAND)
    return max((aliasing_share(source, machine, speed) for speed in speeds for source in sources), default=0.0)


def _flow_per_force(configuration: Configuration, speed_rad_s: float) -> float:
    """Largest relative change of the flow over that of the force, for any flow that the elevator can carry."""
    from yieldmon.estimation.estimators import estimator_of

    machine = configuration.machine
    estimator = estimator_of(machine, configuration.parameters)
    angles, speeds = (np.full(_FORCES_N.shape, value) for value in (machine.home_plate_angle_rad, speed_rad_s))
    flow_kg_s = estimator.estimate(_FORCES_N, angles, speeds).mass_flow_kg_s
    known = flow_kg_s > 0.0
    slopes = np.diff(np.log(flow_kg_s[known])) / np.diff(np.log(_FORCES_N[known]))
    return max(1.0, float(slopes.max(initial=1.0)))


def notes(configuration: Configuration) -> list[str]:
    """What an operator should know of a mapping before it is used, a sentence each."""
    found = []
    aliasing = aliasing_pct(configuration)
    if aliasing:
        rate_hz = min(source.rate_hz for source in configuration.signals.sources.impact)
        parts = ", ".join(f"{share:g} % at {rpm} rpm" for rpm, share in aliasing.items())
        cost = f"standard deviation of a second's flow up to {parts}"
        found.append(f"{rate_hz:g} samples per second alias the paddle passes: {cost}")
    if "impact_force" in configuration.document.signals:
        gain = configuration.machine.sensor.gain_n_per_mv
        found.append(
            f"impact_force is taken as the bus has it: gain_n_per_mv of the machine file ({gain:.4g}) does not apply to it; if "
            "weights hung on the plate gave that gain, bind impact_voltage with unit: mV to the same signals"
        )
    if configuration.engine.plate.fixed_angle_deg is not None:
        home = degrees(configuration.machine.home_plate_angle_rad)
        found.append(f"the plate is fixed at {home:g} deg: no feedback is wanted and no sweep runs")
    for name, value in configuration.signals.sources.fixed.items():
        if name != "plate_angle":
            found.append(f"{name} is taken to be {value:g} {QUANTITIES[name].unit} always")
    for binding, extraction in _bound(configuration):
        if _takes_another_unit(binding, extraction.bits.unit):
            said = f"{binding.quantity} is {extraction.bits.name} in {extraction.bits.unit}, taken as {binding.unit}"
            found.append(f"{said} number for number: if the DBC's unit is right, {_mend_of_unit(binding, extraction.bits.unit)}")
    for taken in configuration.signals.groups:
        for name, extraction in taken.signals.items():
            found += _of_value_names(name, extraction)
    for group in configuration.outputs.groups:
        when = "with each new value" if group.period_s is None else f"every {1000.0 * group.period_s:g} ms"
        source = "xx" if group.own_address else f"{group.frame_id & 0xFF:02X}"
        identifier = f"0x{group.frame_id >> 8:X}{source}" if group.extended else f"0x{group.frame_id:X}"
        for name, packing in group.quantities:
            carried = _carried(packing, PUBLISHED[name].unit)
            found.append(f"{name} goes to {group.name}.{packing.bits.name} ({identifier}), {when}{carried}")
    return found


def _of_value_names(name: str, extraction: Extraction) -> list[str]:
    """What there is to say of the names that the DBC gives to a quantity's raw values."""
    found, bits = [], extraction.bits
    if bits.names_differ:
        said = f"{name}: the DBC has several tables of value names for {bits.name}, which differ; the last counts"
        found.append(f"{said}: give `values` or `not_available`, or mend the DBC")
    codes = codes_by_name(name, bits) if extraction.codes is None else {}
    if codes:
        given = ", ".join(f"{raw}: {code}" for raw, code in sorted(codes.items()))
        taken = f"{name} is taken as {bits.name} has it, {QUANTITIES[name].meaning}"
        found.append(f"{taken}; the DBC's names say otherwise: values: {{{given}}}")
    return found


def _bound(configuration: Configuration) -> list[tuple[Binding, Extraction]]:
    """What is stated of each quantity, and its signal; of an impact sensor's samples the first."""
    stated = {binding.quantity: binding for binding in configuration.signals.bindings if not binding.is_impact}
    stated |= {
        f"impact{number}.0": binding
        for number, binding in enumerate(binding for binding in configuration.signals.bindings if binding.is_impact)
    }
    taken = {name: extraction for group in configuration.signals.groups for name, extraction in group.signals.items()}
    return [(binding, taken[name]) for name, binding in stated.items() if name in taken]


def _takes_another_unit(binding: Binding, unit: str) -> bool:
    """Whether a binding states another unit than the DBC, and nothing that would convert it."""
    if binding.unit is None or binding.pulses_per_turn is not None or not unit or may_be(unit):
        return False
    if (binding.scale, binding.offset, binding.ratio) != (1.0, 0.0, 1.0):
        return False
    own = _own_unit(binding)
    given, stated = ((factor(own, each), zero(own, each)) for each in (unit, binding.unit))
    # A force in N may be bound as a voltage on purpose: for a gain that weights gave.
    return given != stated and not (binding.is_impact and given[0] is None)


def _own_unit(binding: Binding) -> str:
    return IMPACT[binding.quantity] if binding.is_impact else QUANTITIES[binding.quantity].unit


def _mend_of_unit(binding: Binding, unit: str) -> str:
    """What makes the DBC's unit count; a unit that is known converts by itself."""
    return "give `scale` and `offset`" if factor(_own_unit(binding), unit) is None else "leave `unit` out"


def _carried(packing: Packing, unit: str) -> str:
    if packing.counts or packing.codes is not None:
        return ""
    silent = "; without a value no frame is sent" if packing.not_available is None else ""
    ends = sorted(raw * packing.scale + packing.offset for raw in span(packing.bits))
    return f", from {max(packing.low, ends[0]):.6g} to {min(packing.high, ends[1]):.6g} {unit}{silent}"
