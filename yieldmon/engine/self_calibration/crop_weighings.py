"""Weighed loads of the crop harvested now, and of earlier crops, kept for their return."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace

from yieldmon.engine.self_calibration.calibrator_state import GrainState, PriorState
from yieldmon.engine.self_calibration.weighings import Weighings
from yieldmon.estimation.weighing.load_inputs import LoadSettings

Origin = tuple[PriorState, PriorState]
"""Parameters of a crop as they came from outside, and after the updates by weighed loads."""


class CropWeighings:
    """The weighed loads of each crop that has been harvested.

    Parameters
    ----------
    settings : LoadSettings

    Attributes
    ----------
    current : Weighings
        Of the crop that is harvested now.
    """

    def __init__(self, settings: LoadSettings) -> None:
        self._settings = settings
        self.current = Weighings(settings)
        self._others: dict[str, Weighings] = {}
        """Of the crops before, by name."""
        self._origins: dict[str, Origin] = {}
        """Of the crops before, by name."""
        self._earlier: dict[str, GrainState] = {}
        """Crops of a run before that have not been harvested since, by name."""

    @property
    def counted(self) -> frozenset[str]:
        """Names of the loads that count, of any crop."""
        known = (self.current, *self._others.values())
        before = (name for crop in self._earlier.values() for name in crop.weighed)
        return frozenset((*(load.name for weighings in known for load in weighings.counted), *before))

    @property
    def doubted(self) -> frozenset[str]:
        """Names of the loads that contradict those that count, one of a crop."""
        now = (weighings.doubted_name for weighings in (self.current, *self._others.values()))
        return frozenset({*now, *(crop.doubted for crop in self._earlier.values())} - {""})

    def forget(self, names: Container[str]) -> None:
        """Forget the weights of the loads of these names."""
        for weighings in (self.current, *self._others.values()):
            weighings.forget(names)
        for name, crop in self._earlier.items():
            left = tuple(load for load in crop.weighed if load not in names)
            self._earlier[name] = replace(crop, weighed=left, doubted="" if crop.doubted in names else crop.doubted)

    def change(self, before: str, now: str, origin: Origin | None) -> tuple[Origin | None, GrainState | None]:
        """Another crop from now on.

        Parameters
        ----------
        before, now : str
            Names of the crops.
        origin : tuple of PriorState, optional
            Of the crop before.

        Returns
        -------
        origin : tuple of PriorState or None
            Of the crop that is harvested now.
        state : GrainState or None
            State of this crop from an earlier run, whose loads are to be compared again.
        """
        if origin is not None:
            self._origins[before] = origin
        state = self._earlier.pop(now, None)
        back = self._origins.pop(now, None)
        if back is None and state is not None and state.origin is not None and state.left is not None:
            back = state.origin, state.left
        self._others[before] = self.current
        self.current = self._others.pop(now, Weighings(self._settings))
        return back, state

    def states(self) -> tuple[GrainState, ...]:
        """States of the crops before, to keep for a restart."""
        found = dict(self._earlier)
        for crop, weighings in self._others.items():
            names = tuple(load.name for load in weighings.counted)
            origin, left = self._origins.get(crop, (None, None))
            if names or weighings.doubted_name or origin is not None:
                found[crop] = GrainState(crop, names, weighings.doubted_name, origin, left)
        return tuple(found.values())

    def restore(self, states: tuple[GrainState, ...]) -> None:
        """Continue from the states of an earlier run."""
        self._earlier = {crop.crop: crop for crop in states}
