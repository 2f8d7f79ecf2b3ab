"""What a named effect is: parameters with units and bounds, and hooks into the stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from typing import TypeVar

from yieldmon.physics.numerics import AnyArray
from yieldmon.physics.stages import Arrival, Impulse, Jet, Load, Reading, Setting

PLACES = ("fill", "settle", "release", "flight", "impact", "sensor", "crop")
"""Where in the machine an effect may act, in the order in which grain comes there; last, the crop itself."""

Values = Mapping[str, AnyArray]
"""An effect's own parameters by short name, each with a trailing node axis."""

_State = TypeVar("_State")


def where_restitution(hook: Callable[[_State, Values, Setting], _State]) -> Callable[[_State, Values, Setting], _State]:
    """A hook that acts where the impact's gain is 1 + restitution, and leaves the state alone beside k1 and k2.

    Exchange coefficients are fitted to the same readings and stand for what laws of free shape would describe.

    Parameters
    ----------
    hook : callable
        As of `Effect`: takes the state of one step of the throw, the effect's own values and the setting.

    Returns
    -------
    callable
    """

    @wraps(hook)
    def where(state: _State, values: Values, setting: Setting) -> _State:
        return state if setting.restitution is None else hook(state, values, setting)

    return where


def with_force(reading: Reading, force_n: AnyArray, setting: Setting) -> Reading:
    """A reading with a force added that is constant in time.

    Parameters
    ----------
    reading : Reading
    force_n : ndarray
        N, or the response's unit.
    setting : Setting

    Returns
    -------
    Reading
        Its momentum per paddle pass is larger by the force's impulse between two passes.
    """
    return replace(reading, momentum_kg_m_s=reading.momentum_kg_m_s + force_n / setting.passes_per_s)


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect.

    Parameters
    ----------
    name, unit : str
    null : float
        Value at which the effect vanishes.
    lower, upper : float
        Physical bounds.
    prior_sd : float
        Prior standard deviation.
    description : str
    typical : float
        A size at which the effect matters; where searches start.

    Examples
    --------
    >>> api.effects()["gravity"].parameters[0].unit
    'm/s2'
    """

    name: str
    unit: str
    null: float
    lower: float
    upper: float
    prior_sd: float
    description: str
    typical: float


@dataclass(frozen=True, slots=True)
class Effect:
    """A physical effect that the published model leaves out.

    Parameters
    ----------
    name : str
        Of a law that is not the effect's first: the effect's name, a hyphen and the law's.
    stage : str
        Where in the machine it acts: one of `PLACES`.
    summary, signature, source : str
        What it is, how it shows in a table, and where it is described.
    parameters : tuple of EffectParameter
    setting, load, jet, arrival, impulse, reading : callable, optional
        Hooks: each takes the state of one step of the throw, the effect's own values by name and the setting, and returns the
        altered state; `setting` takes the setting and the values.
    needs_misses : bool
        Whether the model is to follow grain that passes below the plate as well.
    needs_moisture : bool
        Whether the effect cannot be worked out without the grain's moisture.
    rank : int
        Effects of a lower rank act first within a stage: 0 and 1 settle which grain passes the low edge, the rest build on it.
    measured : bool
        True for what no diagnosis names: a dimension that one measures, or the model's own error, for which there is no cause.
    law : str
        Name of an alternative law of the effect; "" for the first.
    of_grain : bool
        True for how the grain itself moves, which machines of one geometry share when they cut one crop.
    searched : bool
        False for a law that no diagnosis tries, since another effect describes what it adds; files that name it stay readable.
    unit_follows_response : bool
        True where a parameter is in the reading's own unit, so that it scales with the table's response unit.

    Examples
    --------
    >>> api.effects()["gravity"].stage
    'flight'
    """

    name: str
    stage: str
    summary: str
    signature: str
    source: str
    parameters: tuple[EffectParameter, ...]
    setting: Callable[[Setting, Values], Setting] | None = None
    load: Callable[[Load, Values, Setting], Load] | None = None
    jet: Callable[[Jet, Values, Setting], Jet] | None = None
    arrival: Callable[[Arrival, Values, Setting], Arrival] | None = None
    impulse: Callable[[Impulse, Values, Setting], Impulse] | None = None
    reading: Callable[[Reading, Values, Setting], Reading] | None = None
    needs_misses: bool = False
    needs_moisture: bool = False
    rank: int = 2
    measured: bool = False
    law: str = ""
    of_grain: bool = False
    searched: bool = True
    unit_follows_response: bool = False

    @property
    def family(self) -> str:
        """Name of the effect of which this is one law."""
        return self.name.partition("-")[0]
