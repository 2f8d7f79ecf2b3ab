"""Reference masses as the calibrator uses them: each once, compared with those of its crop that counted before it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from yieldmon.engine.self_calibration.crop_weighings import CropWeighings
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.reference_mass_inputs import checked, weighed, weighed_mass
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck, name_of, name_of_load
from yieldmon.engine.self_calibration.weighings import KEPT_LOADS
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_error import AngleError
from yieldmon.estimation.self_calibration.closed_loop_inputs import WeighedMass
from yieldmon.estimation.weighing.load_inputs import LoadSettings
from yieldmon.estimation.weighing.wrong_tickets import known_slip
from yieldmon.physics.model import ForwardModel

_LEAST_LOAD_ERROR = 1e-4
"""Least relative error of a weighed load's measured mass."""

Found = tuple[ReferenceMass, WeighedMass]
"""A reference mass with the forces over it."""
Spans = Sequence[tuple[float, ParameterSet]]
"""Bus time, s, until which parameters were in use, and these in the model's effects, in order; the last ones to inf."""


class WeighedMasses:
    """The masses that were handed over, those that count, and the one that contradicts these.

    Parameters
    ----------
    reference_error : float
        Relative standard deviation of a reference mass beside its own.

    Attributes
    ----------
    settings : LoadSettings
        How weighed loads are read.
    crops : CropWeighings
        Those that count, by crop.
    used : frozenset of ReferenceMass
        Handed over before.
    """

    def __init__(self, reference_error: float) -> None:
        self._reference_error = reference_error
        self.settings = LoadSettings(load_error=max(reference_error, _LEAST_LOAD_ERROR))
        self.crops = CropWeighings(self.settings)
        self.used: frozenset[ReferenceMass] = frozenset()
        self._checked: frozenset[ReferenceMass] = frozenset()
        """Masses compared with the counted ones."""

    def handed_over(self, masses: Collection[ReferenceMass]) -> None:
        """Note all masses kept, which an update has used or refused."""
        self.used = frozenset(masses)

    def remember(self, masses: Collection[ReferenceMass]) -> None:
        """Note all masses that were handed over and compared before now."""
        self.used = self._checked = frozenset(masses)

    def rests_on(self, masses: Collection[ReferenceMass]) -> None:
        """Add masses that the parameters in use rest on: handed over and compared before now."""
        self.used, self._checked = self.used.union(masses), self._checked.union(masses)

    def use_again(self, masses: Collection[ReferenceMass]) -> None:
        """These masses update the parameters and are compared as if they had not been handed over."""
        self.used, self._checked = self.used.difference(masses), self._checked.difference(masses)

    def forget(self, load_numbers: frozenset[int]) -> None:
        """Forget the weights of these loads, which may be used again."""
        self.crops.forget({name_of_load(number) for number in load_numbers})
        self.use_again({mass for mass in self.used | self._checked if mass.load_number in load_numbers})

    def new(self, masses: Sequence[ReferenceMass], model: ForwardModel, spans: Spans, model_error: AngleError) -> list[Found]:
        """The masses that were measured completely and not handed over yet, each with the forces over it.

        model_error: as `weighed_mass` has it, also of the methods below.
        """
        found = []
        for mass in masses:
            if not mass.comparable or mass in self.used:
                continue
            found.append((mass, weighed_mass(mass, model, spans, self._reference_error, model_error)))
        return found

    def checks(
        self, found: Sequence[Found], model: ForwardModel, stated: ParameterSet, *, moisture_pct: float, model_error: float
    ) -> tuple[ScaleCheck, ...]:
        """Comparison of new masses with the parameters as stated now; each mass once, although a refused one comes again.

        moisture_pct, model_error: as `reference_mass_inputs.checked` has them.
        """
        fresh = [pair for pair in found if pair[0] not in self._checked]
        self._checked = frozenset((*self.used, *(reference for reference, _ in found)))
        checks = (checked(*pair, model, stated, moisture_pct=moisture_pct, model_error=model_error) for pair in fresh)
        return tuple(check for check in checks if check is not None)

    def take(
        self, found: Sequence[Found], model: ForwardModel, prior: ParameterSet, stated: ParameterSet
    ) -> tuple[list[WeighedMass], str]:
        """The masses to update from, and a sentence about a mass that contradicts the loads before it, "" for none.

        prior: what is known now; stated: with all that drift may have added to it. Raises ValueError as `Weighings.take`.
        """
        current = self.crops.current
        accepted, doubt = [], ""
        for reference, mass in found:
            load = weighed(reference, mass)
            error = current.take(load, model, prior, stated)
            if error is None:
                accepted.append(mass)
                continue
            what = known_slip(model, prior, current.counted, load, self.settings)
            doubt = (
                f"{name_of(reference)} contradicts the {len(current.counted)} weighed before it by {100.0 * error:+.1f} %"
                f"{f', as if {what},' if what else ''} and counts for nothing until another agrees with it"
            )
        return accepted, doubt

    def go_on_with(self, masses: Sequence[ReferenceMass], model: ForwardModel, spans: Spans, model_error: AngleError) -> None:
        """From now on the newest of these masses count, by time, and none is doubted."""
        by_time = sorted(masses, key=lambda mass: mass.end_s)
        self.weigh_again([name_of(mass) for mass in by_time][-KEPT_LOADS:], "", by_time, model, spans, model_error)

    def weigh_again(
        self,
        names: Sequence[str],
        doubted: str,
        masses: Sequence[ReferenceMass],
        model: ForwardModel,
        spans: Spans,
        model_error: AngleError,
    ) -> None:
        """Continue with the loads of these names, which counted in an earlier run, and the doubted one."""
        # Of two tickets for one load the newer counts.
        known = {name_of(mass): mass for mass in masses}
        found = {
            name: weighed(mass, weighed_mass(mass, model, spans, self._reference_error, model_error))
            for name, mass in known.items()
            if name in (*names, doubted)
        }
        self.crops.current.restore([found[name] for name in names if name in found], found.get(doubted))
