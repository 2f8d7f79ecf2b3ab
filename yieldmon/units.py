"""Quantities as people read them: SI inside, metric or US customary on screens, in summaries and in pictures.

Documents (JSON), tables and frames stay in SI whatever is chosen here. Sources of the factors: NIST Special Publication 811,
appendix B (pound, inch, foot, acre, mile, kilogram-force).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite

KG_PER_LB = 0.45359237
KG_PER_SHORT_TON = 2000.0 * KG_PER_LB
KG_PER_T = 1000.0
KG_PER_DT = 100.0
M2_PER_ACRE = 4046.8564224
M2_PER_HA = 10_000.0
T_HA_PER_KG_M2 = M2_PER_HA / KG_PER_T
M_PER_IN = 0.0254
M_PER_FT = 0.3048
M_PER_YD = 0.9144
M_PER_MI = 1609.344
M3_PER_BUSHEL = 0.03523907016688
"""The US bushel."""
N_PER_KGF = 9.80665
KMH_PER_M_S = 3.6
M_S_PER_KMH = 1.0 / KMH_PER_M_S
M_S_PER_MPH = 0.44704
M_S_PER_KNOT = 1852.0 / 3600.0
S_PER_H = 3600.0
S_PER_DAY = 86_400.0
_TONNES_FROM_KG = 10_000.0
UNKNOWN = "-"
_NUMBER = r"(?<![\w.,])[+-]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?"
_IN_SI = re.compile(rf"(?:({_NUMBER}) (\+-|to) )?({_NUMBER})(?: kg \(({_NUMBER}) lb\)| (kg/s|kg)(?![\w/]))")
"""A mass or flow in a text, or two of one unit; a mass may have its pounds behind it."""


class UnitSystem(StrEnum):
    """The units that people are shown."""

    METRIC = "metric"
    US = "us"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit to show.

    Parameters
    ----------
    name : str
        As it is written behind a number.
    si : float
        Worth of one in SI (kg, kg/s, m2, kg/m2, m/s).
    """

    name: str
    si: float

    def of(self, value_si: float) -> float:
        """An SI value in this unit."""
        return value_si / self.si


@dataclass(frozen=True, slots=True)
class Units:
    """The units of one system, and of a crop where bushels are wanted.

    Parameters
    ----------
    system : UnitSystem
        Metric or US customary.
    bushel_kg : float or None
        Mass of the crop's bushel; None: not known, and pounds stand for bushels.

    Examples
    --------
    >>> Units(UnitSystem.METRIC).mass(8432.4), Units(UnitSystem.US, 25.4).crop_yield(0.95)
    ('8,432 kg', '151 bu/ac')
    """

    system: UnitSystem = UnitSystem.METRIC
    bushel_kg: float | None = None

    @property
    def _us(self) -> bool:
        return self.system is UnitSystem.US

    @property
    def mass_unit(self) -> Unit:
        """Of loads."""
        return Unit("lb", KG_PER_LB) if self._us else Unit("kg", 1.0)

    @property
    def flow_unit(self) -> Unit:
        """Of mass flow: bushels an hour where the crop is known."""
        if not self._us:
            return Unit("kg/s", 1.0)
        return Unit("lb/s", KG_PER_LB) if self.bushel_kg is None else Unit("bu/h", self.bushel_kg / S_PER_H)

    @property
    def yield_unit(self) -> Unit:
        """Of mass by area."""
        if not self._us:
            return Unit("t/ha", KG_PER_T / M2_PER_HA)
        bushel = self.bushel_kg
        return Unit("lb/ac", KG_PER_LB / M2_PER_ACRE) if bushel is None else Unit("bu/ac", bushel / M2_PER_ACRE)

    @property
    def area_unit(self) -> Unit:
        """Of area."""
        return Unit("ac", M2_PER_ACRE) if self._us else Unit("ha", M2_PER_HA)

    @property
    def speed_unit(self) -> Unit:
        """Of driving."""
        return Unit("mph", M_S_PER_MPH) if self._us else Unit("km/h", M_S_PER_KMH)

    def mass(self, kg: float | None) -> str:
        """A mass; in metric units tonnes from 10 t on."""
        if kg is not None and not self._us and abs(kg) >= _TONNES_FROM_KG:
            return f"{kg / KG_PER_T:,.2f} t"
        return _shown(kg, self.mass_unit)

    def mass_with_bushels(self, kg: float | None) -> str:
        """A mass, in US units with its bushels where the crop is known."""
        if kg is None or not self._us or self.bushel_kg is None:
            return self.mass(kg)
        return f"{self.mass(kg)} ({rounded(kg / self.bushel_kg)} bu)"

    def in_text(self, text: str) -> str:
        """What a daemon says, with its masses and flows, which it has in SI, in these units.

        >>> Units(UnitSystem.US).in_text("load 6 weighed 9072 kg, measured 1,840 kg (4,056 lb): 12.0 kg/s")
        'load 6 weighed 20,000 lb, measured 4,056 lb (1,840 kg): 26.5 lb/s'
        >>> Units(UnitSystem.US).in_text("leaves -1000 +- 27 kg; expected a mass from 1 to 1e+06 kg")
        'leaves -2,205 +- 59.5 lb; expected a mass from 2.20 to 2,204,623 lb'
        """
        return _IN_SI.sub(self._restated, text) if self._us else text

    def _restated(self, found: re.Match[str]) -> str:
        first, between, kg, pounds, unit = found.groups()
        shown = self.flow if unit == "kg/s" else self.mass
        before = "" if first is None else f"{_signed(first, shown).rpartition(' ')[0]} {between} "
        if pounds is not None:
            return f"{before}{pounds} lb ({kg} kg)"
        return before + _signed(kg, shown)

    def flow(self, kg_s: float | None) -> str:
        """A mass flow."""
        return _shown(kg_s, self.flow_unit)

    def crop_yield(self, kg_m2: float | None) -> str:
        """A yield."""
        return _shown(kg_m2, self.yield_unit)

    def area(self, m2: float | None) -> str:
        """An area, to a hundredth of the unit."""
        unit = self.area_unit
        return UNKNOWN if m2 is None or not isfinite(m2) else f"{unit.of(m2):,.2f} {unit.name}"

    def speed(self, m_s: float | None) -> str:
        """A ground speed, to a tenth."""
        unit = self.speed_unit
        return UNKNOWN if m_s is None or not isfinite(m_s) else f"{unit.of(m_s):.1f} {unit.name}"


def _signed(number: str, shown: Callable[[float], str]) -> str:
    """A number of a text as a quantity, with the plus that it has."""
    return "+" * number.startswith("+") + shown(float(number.replace(",", "")))


def moisture(pct: float | None) -> str:
    """A moisture, to a tenth of a percent."""
    return UNKNOWN if pct is None or not isfinite(pct) else f"{pct:.1f} %"


def rounded(value: float) -> str:
    """A number with three digits that count, whole from 100 on, and thousands apart.

    >>> rounded(8432.4), rounded(12.34), rounded(0.5), rounded(-0.001)
    ('8,432', '12.3', '0.50', '0.0')
    """
    size = abs(value)
    digits = 0 if size >= 99.95 else 1 if size >= 9.995 or size < 0.005 else 2
    return f"{value:z,.{digits}f}"


def crop_yield_kg_m2(mass_kg: float | None, area_m2: float | None) -> float | None:
    """Mass by area; None where one of them is not known or there is no area."""
    if mass_kg is None or area_m2 is None or not area_m2 > 0.0 or not isfinite(mass_kg):
        return None
    return mass_kg / area_m2


def _shown(value_si: float | None, unit: Unit) -> str:
    return UNKNOWN if value_si is None or not isfinite(value_si) else f"{rounded(unit.of(value_si))} {unit.name}"


def counted(number: int, what: str) -> str:
    """A number of things.

    >>> counted(1, "machine"), counted(3, "machine")
    ('1 machine', '3 machines')
    """
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
