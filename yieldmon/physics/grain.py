"""The parameters of grain: names, symbols, units, limits, where fits search and start, scales, drift, published signals.

One entry describes a parameter for the forward model, calibration, diagnosis, daemon, files, plots and docs. Limits and ranges:
"Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), section 9.1 and chapter 12.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .numerics import Array

RESTITUTION_FORM = ("restitution",)
"""Parameters of the impact gain 1 + e."""
EXCHANGE_FORM = ("k1", "k2")
"""Parameters of the impact gain k1 M / M_full + k2 [8.23]."""
DRIEST_PCT = 2.0
"""Moisture, wet basis, below which no grain is harvested: a meter at 0 has none to measure, or sends a share of 1."""
WETTEST_PCT = 60.0
"""Moisture, wet basis, above which no grain is threshed: a meter's short circuit, or its error value."""
FLOW_PER_MOISTURE_PCT = 0.02
"""Relative change of the flow by a point of moisture that the parameters do not follow."""


@dataclass(frozen=True, slots=True)
class Drift:
    """Defaults of a parameter's drift between calibrations, as relative standard deviations.

    per_root_hour: after one hour, harvested or not. per_root_kilotonne: after 1000 t of grain. limit: where the growth ends.
    steady_per_kilotonne: likely size of a steady rate; 0: none is looked for.
    """

    per_root_hour: float
    per_root_kilotonne: float
    limit: float
    steady_per_kilotonne: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GrainParameter:
    """One parameter of the grain.

    Parameters
    ----------
    name, symbol, unit, label
        How it is written in files, in formulas, beside numbers, and in pictures.
    limits
        Values that are possible at all; files and options refuse others.
    search
        The physical prior: fits stay inside, in calibration and in diagnosis alike.
    start
        Where random starts are drawn.
    typical
        The value where nothing is known.
    step
        A change that matters; the unit of a fit's steps.
    fitted
        Whether a calibration and a diagnosis fit it unless asked otherwise.
    form
        "" for grain itself, else the form of the impact gain that it belongs to.
    default
        Its value where a parameter file does not contain it; None: the file must.
    follows_response
        Whether it is in the reading's own unit; limits, search, start, typical and step are then per unit of scale.
    offset, floor
        Relative changes are relative to value + offset, at least floor.
    along_scale
        Exponent of the change (mass flow, density, impact gain) -> (a, a, 1/a), which no force can show.
    drift, drift_of
        Defaults of its drift, or the name of the parameter whose drift it shares.
    signal
        Signal of the frame SelfCalibrationStatus that it is published in, added to the others of that signal.
    """

    name: str
    symbol: str
    unit: str
    label: str
    limits: tuple[float, float]
    search: tuple[float, float]
    start: tuple[float, float]
    typical: float
    step: float
    fitted: bool = True
    form: str = ""
    default: float | None = None
    follows_response: bool = False
    offset: float = 0.0
    floor: float = 1e-12
    along_scale: float = 0.0
    drift: Drift | None = None
    drift_of: str = ""
    signal: str = ""

    @property
    def axis_label(self) -> str:
        """Label, symbol and unit, for the axis of a picture."""
        unit = self.unit.replace("m3", "m³")
        return f"{self.label} {self.symbol}" + (f", {unit}" if unit else "")


_ALL = (
    GrainParameter(
        name="friction", symbol="μ", unit="", label="friction",
        limits=(0.0, 5.0), search=(0.0, 1.0), start=(0.0, 1.0), typical=0.3, step=0.2, floor=0.05,
        drift=Drift(0.002, 0.04, 0.5, 0.15), signal="Friction",
    ),
    GrainParameter(
        name="density", symbol="η", unit="kg/m3", label="bulk density",
        limits=(1.0, 20000.0), search=(750.0, 2000.0), start=(750.0, 2000.0), typical=1100.0, step=500.0, along_scale=1.0,
        drift=Drift(0.001, 0.02, 0.2, 0.04),
    ),
    GrainParameter(
        name="shape_ratio", symbol="h_f", unit="", label="shape ratio",
        limits=(0.05, 6.0), search=(0.2, 6.0), start=(1.0, 3.0), typical=2.0, step=0.6, fitted=False,
    ),
    GrainParameter(
        name="restitution", symbol="e", unit="", label="restitution", form="restitution",
        limits=(0.0, 1.0), search=(0.0, 1.0), start=(0.0, 1.0), typical=0.5, step=0.3, offset=1.0, along_scale=-1.0,
        drift=Drift(0.0005, 0.01, 0.1, 0.02), signal="ImpactGain",
    ),
    GrainParameter(
        name="k1", symbol="k1", unit="", label="exchange coefficient", form="exchange",
        limits=(-60.0, 60.0), search=(-60.0, 60.0), start=(-1.0, 4.0), typical=0.5, step=1.0, follows_response=True,
        along_scale=-1.0, drift_of="restitution", signal="ImpactGain",
    ),
    GrainParameter(
        name="k2", symbol="k2", unit="", label="exchange coefficient", form="exchange",
        limits=(-60.0, 60.0), search=(0.0, 60.0), start=(0.0, 2.0), typical=1.0, step=1.0, follows_response=True,
        along_scale=-1.0, drift_of="restitution", signal="ImpactGain",
    ),
)  # fmt: skip

GRAIN: Mapping[str, GrainParameter] = MappingProxyType({p.name: p for p in _ALL})
"""Every parameter by name, in the order in which files and reports list them."""

REQUIRED = tuple(p.name for p in _ALL if not p.form and p.default is None)
"""Parameters that every set has, beside those of one form of the impact gain."""

OPTIONAL = tuple(p.name for p in _ALL if not p.form and p.default is not None)
"""Parameters that a set may leave out; stages find them in `Setting.grain`."""

DRIFTING = tuple(p.name for p in _ALL if p.drift is not None)
"""Parameters with drift defaults of their own."""


def fitted(form: str) -> tuple[str, ...]:
    """Names that a calibration or diagnosis fits, with the impact gain in `form` ("restitution" or "exchange")."""
    return tuple(p.name for p in _ALL if p.fitted and p.form in ("", form))


def drift_key(name: str) -> str:
    """The parameter whose drift a parameter has; its own name where it is not in the registry."""
    known = GRAIN.get(name)
    return known.drift_of or name if known is not None else name


def natural_scale(parameter: GrainParameter, value: float) -> float:
    """What a relative change is relative to; coefficients in the reading's unit keep their sign, so a gain changes as a whole."""
    if parameter.follows_response:
        return value if abs(value) > parameter.floor else parameter.floor
    return max(abs(value + parameter.offset), parameter.floor)


def published(values: Mapping[str, float]) -> dict[str, float]:
    """Signals of the frame SelfCalibrationStatus with grain parameters: friction, and the impact gain 1 + e or k1 + k2."""
    out: dict[str, float] = {}
    for p in _ALL:
        if p.signal and p.name in values:
            out[p.signal] = out.get(p.signal, 0.0) + p.offset + values[p.name]
    return out


_NEAR_END = 0.02
"""Share of the range that fits search within which a value counts as on its end."""


def at_search_end(values: Mapping[str, float], names: Iterable[str]) -> tuple[str, ...]:
    """Which of the names lie at an end of the range that fits search; a value well outside was put there by a person."""
    out = []
    for name in names:
        if name in GRAIN and not GRAIN[name].follows_response:
            low, high = GRAIN[name].search
            if min(abs(values[name] - low), abs(values[name] - high)) <= _NEAR_END * (high - low):
                out.append(name)
    return tuple(out)


def evenly(name: str, count: int) -> Array:
    """`count` values inside the range that fits search, without its ends."""
    low, high = GRAIN[name].search
    return low + (high - low) * (np.arange(count) + 0.5) / count
