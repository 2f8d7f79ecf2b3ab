"""Where the parameters in use came from, and which were in use before them."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from yieldmon.engine.self_calibration.calibrator_state import PriorState
from yieldmon.engine.self_calibration.crop_weighings import Origin
from yieldmon.engine.self_calibration.prior_states import agrees_with, as_prior_state, as_set
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.estimation.load_pattern import EFFECT as LOAD_PATTERN
from yieldmon.estimation.parameters import ParameterSet

_KEPT_SETS = 8
"""Sets of parameters kept, with any of which a reference mass may have been measured."""


class _Before(NamedTuple):
    """Earlier parameters, the bus time until which they were in use, and the masses that had been handed over by then."""

    until_s: float
    parameters: ParameterSet
    handed: frozenset[ReferenceMass]


class ParameterLineage:
    """The sets of parameters of one machine in order of use, compared by identity."""

    def __init__(self) -> None:
        self._last: ParameterSet | None = None
        self._origin: ParameterSet | None = None
        self._given: ParameterSet | None = None
        """Parameters from outside, as long as only sweeps have updated them since."""
        self._restored: ParameterSet | None = None
        """Parameters in use at a restart or at a crop's return, where their origin is known."""
        self._updated: ParameterSet | None = None
        """Result of the last update."""
        self._history: tuple[_Before, ...] = ()

    @property
    def last(self) -> ParameterSet | None:
        """Parameters last seen in use."""
        return self._last

    @property
    def origin(self) -> ParameterSet | None:
        """Parameters as they came from outside."""
        return self._origin

    def seen(self, used: ParameterSet) -> None:
        """These are in use."""
        self._last = used

    def swept(self, used: ParameterSet) -> None:
        """A sweep was made with these: unless they come from an update, they are the given ones."""
        if used is not self._updated:
            self._given = used
        self.weighed(used)

    def weighed(self, used: ParameterSet) -> None:
        """A mass was weighed with these: unless they come from an update, they are the origin of later ones."""
        if used is not self._updated and used is not self._restored:
            self._origin, self._restored = used, None

    def forget_given(self) -> None:
        """Another update than by a sweep has come, which an undo of the sweeps must keep."""
        self._given = None

    def undo_sweeps(self, used: ParameterSet, until_s: float, handed: frozenset[ReferenceMass]) -> ParameterSet | None:
        """The given parameters, in use again from now on; None where those in use stay. Arguments as of `replaced`."""
        if self._given is None or self._given is used:
            return None
        self._given = replace(self._given, version=used.version + 1)
        self.replaced(used, until_s, self._given, handed)
        return self._given

    def from_outside(self, used: ParameterSet) -> bool:
        """Whether these parameters come neither from an update nor from an undo."""
        before = any(dict(used.values) == dict(before.parameters.values) for before in self._history)
        return used is not self._updated and used is not self._restored and not before

    def replaced(self, used: ParameterSet, until_s: float, known: ParameterSet, handed: frozenset[ReferenceMass]) -> None:
        """An update led to other parameters.

        Parameters
        ----------
        used : ParameterSet
            In use until then.
        until_s : float
            Bus time of the update, s.
        known : ParameterSet
            What it led to.
        handed : frozenset of ReferenceMass
            Masses that had been handed over before it.
        """
        self._history = (*self._history[1 - _KEPT_SETS :], _Before(until_s, used, handed))
        self._updated = known

    def spans(self, used: ParameterSet) -> tuple[tuple[float, ParameterSet], ...]:
        """(bus time until which they were in use, s; parameters) in order, the last one with inf."""
        return (*((before.until_s, before.parameters) for before in self._history), (inf, used))

    def handed_before(self, restored: ParameterSet, handed: frozenset[ReferenceMass]) -> frozenset[ReferenceMass]:
        """The masses that had been handed over when the restored parameters were in use; where these are older than all kept,
        those of the oldest set. handed: those handed over by now."""
        now = () if self._updated is None else (_Before(inf, self._updated, handed),)
        known: list[_Before] = [*self._history, *now]
        for before in reversed(known):
            same = dict(before.parameters.values) == dict(restored.values)
            if same and np.array_equal(before.parameters.covariance, restored.covariance):
                return before.handed
        return self._history[0].handed if self._history else handed

    def brought_back(self, used: ParameterSet) -> None:
        """An undo restored these parameters: they have the same origin as the update that was undone."""
        if self._origin is not None:
            self._updated, self._restored = None, used

    def leave_crop(self) -> Origin | None:
        """Another crop from now on. Returns origin and last parameters of the crop before; None where nothing updated them."""
        origin, known = self._origin, self._updated or self._restored
        self._given = self._origin = self._restored = self._updated = None
        return None if origin is None or known is None else (as_prior_state(origin), as_prior_state(known))

    def return_to_crop(self, origin: Origin | None, back: ParameterSet) -> None:
        """The crop of these parameters is back; origin: as `leave_crop` returned it."""
        if origin is not None and agrees_with(back, origin[1]):
            self._origin, self._restored = as_set(origin[0], back), back

    def snapshot(self) -> PriorState | None:
        """The origin, to keep for a restart; None where nothing was updated from it."""
        origin, known = self._origin, self._updated or self._restored
        if origin is None or known is None or origin is known:
            return None
        if LOAD_PATTERN in origin.effects and not origin.carried_from:
            return None
        return replace(as_prior_state(origin), version=known.version)

    def restore(self, origin: PriorState | None, parameters: ParameterSet) -> None:
        """Continue with the parameters in use at a restart, and the origin from the snapshot."""
        if origin is not None and origin.version == parameters.version:
            self._restored, self._origin = parameters, as_set(origin, parameters)
