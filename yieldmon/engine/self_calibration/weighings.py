"""The weighed loads that count: a load that contradicts several others waits until a further one agrees with it."""

from __future__ import annotations

from collections.abc import Container, Sequence

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.load_departures import departure
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad
from yieldmon.estimation.weighing.wrong_tickets import LEAST_LOADS, contradicted
from yieldmon.physics.model import ForwardModel

KEPT_LOADS = 6
"""Newest loads that count, with which a new one is compared."""


class Weighings:
    """Weighed loads in order.

    A load counts however far it is from the parameters. Only one that contradicts several others waits until a further load
    agrees with it; then both count, and the earlier ones no longer do.
    """

    def __init__(self, settings: LoadSettings) -> None:
        self._settings = settings
        self._counted: tuple[WeighedLoad, ...] = ()
        self._doubted: WeighedLoad | None = None

    @property
    def counted(self) -> tuple[WeighedLoad, ...]:
        """The last loads that count."""
        return self._counted

    @property
    def doubted_name(self) -> str:
        """Of the load that contradicts them, "" for none."""
        return "" if self._doubted is None else self._doubted.name

    def take(self, load: WeighedLoad, model: ForwardModel, prior: ParameterSet, stated: ParameterSet) -> float | None:
        """Add a load, or one of these again: None where it counts, else its relative error by the loads before it.

        prior: what is known now, in the model's effects; stated: with all that drift may have added to it. Raises
        ValueError as `loads.calibrate_loads`.
        """
        # A mass whose update was refused is handed over again.
        self._counted = tuple(known for known in self._counted if known.name != load.name)
        error = self._contradiction(load, model, prior, stated)
        if error is None:
            self._counted = (*self._counted[1 - KEPT_LOADS :], load)
            return None
        doubted = self._doubted
        if doubted is not None and contradicted(model, prior, [doubted], load, self._settings, least=1) is None:
            self._counted, self._doubted = (doubted, load), None
            return None
        self._doubted = load
        return error

    def forget(self, names: Container[str]) -> None:
        """Forget the loads of these names."""
        self._counted = tuple(load for load in self._counted if load.name not in names)
        if self._doubted is not None and self._doubted.name in names:
            self._doubted = None

    def restore(self, counted: Sequence[WeighedLoad], doubted: WeighedLoad | None) -> None:
        """Continue with the loads of an earlier run."""
        self._counted, self._doubted = tuple(counted), doubted

    def _contradiction(self, load: WeighedLoad, model: ForwardModel, prior: ParameterSet, stated: ParameterSet) -> float | None:
        """Relative error of a weighed mass by the loads before it, None where scatter or drift since then explains it."""
        if len(self._counted) < LEAST_LOADS:
            return None
        away, std_dev = departure(model, stated, load, self._settings)
        # The stated parameters allow for other grain and more wear than at the loads before.
        if abs(away) < self._settings.outlier_sds * std_dev:
            return None
        return contradicted(model, prior, self._counted, load, self._settings)
