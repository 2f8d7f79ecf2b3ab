"""Which parameters are in use, which were before, and which are known for each crop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from yieldmon.documents.calibrations import CalibrationRow
from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.errors import InputError
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import BY_KERNELS, NOT_CALIBRATED, SCALE, WEIGHED, ParameterSet
from yieldmon.estimation.weighing.other_crop import carried
from yieldmon.files import parameter_file
from yieldmon.files.crops import SHIPPED_CROP, crops
from yieldmon.service.history.memory import KEPT_VERSIONS, Memory, by_crop
from yieldmon.service.history.update_steps import step_document
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Load, ParameterVersion, Step
from yieldmon.service.tickets.action_log import ActionLog


class ParameterHistory:
    """Numbers the parameters that come into use; each change is in the action log."""

    def __init__(self, memory: Memory, configured: ParameterSet, actions: ActionLog) -> None:
        """memory: what the store holds. configured: the parameters as their file has them."""
        self.digest = parameter_file.digest(configured)
        """Of the parameter file last read."""
        self.version = memory.last_version
        """In use."""
        self._actions = actions
        self._in_use = (memory.parameters, memory.parameter_origin) if memory.parameters is not None else None
        self._of_crop = dict(memory.of_crop)
        self._versions = dict(memory.versions)
        self._new: list[tuple[ParameterSet, str]] = []
        self._new_steps: list[tuple[int, CalibrationStep]] = []
        self._fresh: ParameterSet | None = None
        self._shipped_digest = parameter_file.digest(parameter_file.load())

    def crop_of(self, parameters: ParameterSet, named: str) -> str:
        """Whose crop parameters are, "" where none was named. named: the crop that an operator named last."""
        return parameters.provenance.get("crop", named) or (SHIPPED_CROP if self.digest == self._shipped_digest else "")

    def change_crop(self, crop: str, in_use: ParameterSet, named: str, who: str = "", last_load: int = 0) -> ParameterSet | None:
        """Take the parameters of another crop into use; what is known of the crop before is kept.

        Parameters
        ----------
        crop : str
            The new crop.
        in_use : ParameterSet
            The parameters in use.
        named : str
            The crop that an operator named last.
        who : str
            The user who asks.
        last_load : int
            Number of the newest load.

        Returns
        -------
        ParameterSet or None
            The crop's last known parameters; else the shipped ones, with the measured offset of the plate's angle and the scale
            of a weighed crop; else a copy of those in use, which tickets from now on update for this crop alone. None where those
            in use stay: they are its own, or nothing says whose they are.
        """
        before = self.crop_of(in_use, named)
        if crop == before or not before:
            return None
        known = self.of(crop, in_use, named)
        kept = replace(in_use, version=self.version + 1, provenance={**in_use.provenance, "crop": before})
        self._of_crop[before] = kept
        self.use(kept, ParameterOrigin.CROP, who=who, reason=f"what is known of {before} is kept", last_load=last_load)
        if known is None:
            # The scale was weighed with grain of the crop before.
            facts = {**in_use.provenance, SCALE: NOT_CALIBRATED, "crop": crop}
            chosen = replace(in_use, version=self.version + 1, provenance=facts)
            self.use(chosen, ParameterOrigin.CROP, who=who, reason=f"{crop} begins with what is known of {before}")
            return chosen
        chosen, left = replace(known, version=self.version + 1), self._of_crop.get(crop)
        self.use(chosen, ParameterOrigin.CROP, who=who, reason=_source_in_words(chosen, crop))
        if left is not None and left.values != chosen.values:
            # Its loads until now had another scale.
            self._actions.remeasuring.bring_back(chosen.version)
        return chosen

    def crop_of_version(self, version: int, in_use: ParameterSet, named: str) -> str:
        """Whose crop a version's parameters are, "" where nothing says so. named: the crop that an operator named last."""
        return self._crop_at(version) or self.crop_of(in_use, named)

    def crop_of_load(self, load: Load) -> str:
        """As it was named, else that whose parameters were in use until another's were; "" where none were yet."""
        changes = (a.document for a in self._actions.history.updates.values() if a.document.get("last_load", 0) >= load.number)
        return load.crop or next((str(document["crop"]) for document in changes), "")

    def keeps(self, crop: str) -> bool:
        """Whether parameters of this crop were in use before another's."""
        return crop in self._of_crop

    def of(self, crop: str, in_use: ParameterSet, named: str) -> ParameterSet | None:
        """What is known of a crop; None where nothing is. named: the crop that an operator named last.

        Parameters in use of which nothing says whose they are are any crop's, as in `change_crop`.
        """
        if self.crop_of(in_use, named) in ("", crop):
            return in_use
        known = self._of_crop.get(crop)
        if crop not in crops() or (known is not None and not _only_begun(known, crop)):
            return known
        begun = self._begun(crop, ((self.crop_of(in_use, named), in_use),), _machine_values(in_use))
        return begun if known is None or known.carried_from or begun.carried_from else known

    def _begun(self, crop: str, in_use: Sequence[tuple[str, ParameterSet]], of_the_plate: Mapping[str, float]) -> ParameterSet:
        """What a shipped crop begins with: its published properties, with the scale of a crop that was weighed on this machine:
        that of those in use first, then the newest."""
        shipped = crops()[crop].parameters()
        published = replace(shipped, values={**shipped.values, **of_the_plate})
        kept = sorted(self._of_crop.items(), key=lambda item: item[1].version, reverse=True)
        for other, known in (*in_use, *kept):
            if other in crops() and other != crop and known.provenance.get(SCALE) in (WEIGHED, BY_KERNELS):
                found = carried(published, known, crops()[other].parameters(), other)
                if found is not None:
                    return found
        return published

    def unlike(self, configured: ParameterSet) -> ParameterSet | None:
        """The parameters to use from now on after their file was read again; None where the file has not changed."""
        return None if parameter_file.digest(configured) == self.digest else replace(configured, version=self.version + 1)

    def restart(self, in_use: ParameterSet, named: str, who: str, reason: str) -> ParameterSet:
        """After a change of the machine: what is shipped of the crop in use, with the plate's angle as it was measured, or a copy
        of the parameters in use for another one, as a new version of which no scale is known. Nothing is kept of other crops.

        named: the crop that an operator named last. reason: as the list of calibrations shows it.
        """
        crop = self.crop_of(in_use, named)
        known = in_use
        if crop in crops():
            shipped = crops()[crop].parameters()
            known = replace(shipped, values={**shipped.values, **_machine_values(in_use)})
        facts = {**known.provenance, SCALE: NOT_CALIBRATED} | ({"crop": crop} if crop else {})
        chosen = replace(known, version=self.version + 1, provenance=facts)
        self.use(chosen, ParameterOrigin.HARDWARE, who=who, reason=reason)
        self._of_crop = {}
        self._fresh = chosen
        return chosen

    def take_fresh(self) -> ParameterSet | None:
        """Parameters of the last `restart`, with which a new monitor has to begin; None after they were taken."""
        fresh, self._fresh = self._fresh, None
        return fresh

    def configure(self, configured: ParameterSet) -> None:
        """This file's parameters are those to begin with from now on."""
        self.digest = parameter_file.digest(configured)

    def undo(
        self,
        version: int,
        in_use: ParameterSet,
        *,
        named: str,
        who: str,
        now_s: float,
        silenced: Sequence[int] = (),
        replaced: int = 0,
    ) -> tuple[ParameterSet, str]:
        """Take a version and those that followed on it back.

        Parameters
        ----------
        version : int
            The first to take back.
        in_use : ParameterSet
            The parameters in use.
        named : str
            The crop that an operator named last.
        who : str
            The user who asks.
        now_s : float
            Unix time.
        silenced : sequence of int
            Tickets that no longer update the parameters.
        replaced : int
            The ticket that a newer one replaces; 0 where that is not why.

        Returns
        -------
        ParameterSet
            In use from now on: those from before the version, as a new version; or those in use, where the version is of another
            crop, for which those from before it are kept.
        str
            That other crop; "" where the version is of the crop harvested now.

        Raises
        ------
        InputError
            For a version that cannot be taken back.
        """
        self._refuse_undo(version)
        changes = self._actions.history.updates
        before = int(changes[version].document.get("from_version", 0))
        now, crop = self.crop_of(in_use, named), self._crop_at(version)
        of_now = not crop or not now or crop == now
        followed = self._followed(version, (crop, "") if of_now else (crop,))
        document = {"version": version, "versions": followed} | ({"tickets": list(silenced)} if silenced else {})
        document |= {"replaced": replaced} if replaced else {}
        self._actions.add(ledgers.PARAMETERS_UNDO, who, document, now_s)
        if changes[version].document.get("origin") == ParameterOrigin.HARDWARE:
            undone = self._actions.history.undone_versions
            self._of_crop = by_crop(
                (self._versions[v], str(changes[v].document.get("origin")))
                for v in sorted(changes)
                if v in self._versions and v not in undone
            )
        earlier = replace(self._versions[before], version=self.version + 1)
        if of_now:
            self.use(earlier, ParameterOrigin.UNDO, who=who, reason=f"version {version} undone: as version {before}")
            self._actions.remeasuring.bring_back(earlier.version)
            return earlier, ""
        kept = self._of_crop[crop] = replace(earlier, provenance={**earlier.provenance, "crop": crop})
        self.use(kept, ParameterOrigin.UNDO, who=who, reason=f"version {version} of {crop} undone: as version {before}")
        self._actions.remeasuring.bring_back(kept.version)
        # What is in use may have the scale of the version that is undone.
        anew = in_use.carried_from == crop and _only_begun(in_use, now)
        left = self._begun(now, (), _machine_values(in_use)) if anew else in_use
        chosen = replace(left, version=self.version + 1, provenance={**left.provenance, "crop": now})
        self.use(chosen, ParameterOrigin.CROP, who=who, reason=_source_in_words(chosen, now))
        if anew:
            self._actions.remeasuring.bring_back(chosen.version)
        return chosen, crop

    def _refuse_undo(self, version: int) -> None:
        """Raises InputError for a version that cannot be taken back."""
        history = self._actions.history
        change, where = history.updates.get(version), f"version {version}"
        if change is None:
            raise InputError(where, "no such calibration", "a version that `yieldmon calibrations list` shows")
        if version in history.undone_versions:
            raise InputError(where, "is undone already", "one that is not undone")
        if change.document.get("origin") == ParameterOrigin.CROP:
            raise InputError(where, "is a change of crop", "a calibration, or `yieldmon load start --crop NAME`")
        gone = history.updates_gone_with(version)
        if gone:
            raise InputError(
                where,
                f"is an undo; what it took back used ticket {', '.join(map(str, gone))}, which no longer updates the parameters",
                f"the ticket entered anew, if it is right: `yieldmon ticket {history.as_entered(gone[0])}`",
            )
        if int(change.document.get("from_version", 0)) not in self._versions:
            raise InputError(where, "the parameters before it are not known", "a later version")

    def withdraw(self, version: int, who: str, now_s: float, replaced: int = 0) -> None:
        """Take back the masses that were measured again with a version before the parameter file in use, or with versions that
        followed on it before that file: they rest on something that was undone. The parameters in use stay. replaced: as `undo`
        has it."""
        changes = self._actions.history.updates
        file = min(later for later in changes if later > version and ledgers.begins_anew(changes[later]))
        before_file = [later for later in self._followed(version, (self._crop_at(version), "")) if later < file]
        document = {"version": version, "versions": before_file} | ({"replaced": replaced} if replaced else {})
        self._actions.add(ledgers.PARAMETERS_UNDO, who, document, now_s)

    def _followed(self, version: int, crops: Sequence[str]) -> list[int]:
        """A version and those after it, of these crops where it is of one; of every crop after a change of the machine."""
        changes = self._actions.history.updates
        if changes[version].document.get("origin") == ParameterOrigin.HARDWARE:
            return [later for later in sorted(changes) if later >= version]
        return [
            later
            for later in sorted(changes)
            if later >= version and (later == version or changes[later].document.get("origin") != ParameterOrigin.CROP)
            and (not self._crop_at(version) or self._crop_at(later) in crops)
        ]  # fmt: skip

    def _crop_at(self, version: int) -> str:
        """Whose crop a version is: it says so, or the one that a change of crop kept first since; "" where none does."""
        since = (self._versions[known].provenance for known in sorted(self._versions) if known >= version)
        return next((provenance["crop"] for provenance in since if "crop" in provenance), "")

    def use(
        self,
        parameters: ParameterSet,
        origin: str,
        *,
        who: str = "",
        reason: str = "",
        tickets: Sequence[int] = (),
        step: CalibrationStep | None = None,
        last_load: int | None = None,
    ) -> None:
        """Take parameters into use.

        Parameters
        ----------
        parameters : ParameterSet
            With their new version.
        origin : str
            A `ParameterOrigin`.
        who : str
            The user who asked; "" for the monitor itself.
        reason : str
            As the list of calibrations shows it.
        tickets : sequence of int
            That led to them.
        step : CalibrationStep, optional
            How they followed from those before them.
        last_load : int, optional
            Last load that is of their crop if it was given none.
        """
        document = {
            "version": parameters.version, "from_version": self.version, "origin": origin, "reason": reason,
            "effects": list(parameters.effects), "tickets": list(tickets),
        } | ({} if last_load is None else {"crop": parameters.provenance["crop"], "last_load": last_load})  # fmt: skip
        self._actions.add(ledgers.PARAMETERS, who, document)
        self._versions[parameters.version] = parameters
        while len(self._versions) > KEPT_VERSIONS:
            del self._versions[min(self._versions)]
        if step is not None:
            self._new_steps.append((parameters.version, step))
        self.version = parameters.version
        self._in_use = (parameters, origin)
        self._new.append(self._in_use)

    def table(self, in_use: ParameterSet, named: str) -> list[CalibrationRow]:
        """All changes of parameters and zeros by an operator, with who and when. named: the crop that an operator named last."""

        def crop_of(version: int) -> str:
            return self.crop_of_version(version, in_use, named) if version in self._versions else ""

        return ledgers.calibration_rows(self._actions, self.version, crop_of)

    def take(self, time_s: float) -> tuple[tuple[ParameterVersion, ...], tuple[Step, ...]]:
        """Versions and steps that no batch has brought yet; they count as brought. time_s: Unix time."""
        versions = tuple(
            ParameterVersion(parameters.version, time_s, origin, parameter_file.to_document(parameters))
            for parameters, origin in self._new
        )
        steps = tuple(Step(version, step.end_s, step_document(step)) for version, step in self._new_steps)
        self._new, self._new_steps = [], []
        return versions, steps

    def report_all(self) -> None:
        """The next batch brings those in use."""
        if self._in_use is not None and self._in_use not in self._new:
            self._new.insert(0, self._in_use)


def _source_in_words(parameters: ParameterSet, crop: str) -> str:
    """Where a crop's parameters come from, in words."""
    other = parameters.carried_from
    return f"{crop} begins with the scale of {other}" if other else f"what is known of {crop}"


def _only_begun(parameters: ParameterSet, crop: str) -> bool:
    """Whether nothing has changed what a shipped crop began with; a sweep always changes what is known of friction."""
    published = crops()[crop].parameters()
    if not parameters.carried_from:
        grain = {name: value for name, value in parameters.values.items() if name in published.values}
        return parameters.scale_error > 0.0 and grain == dict(published.values)
    friction = parameters.values["friction"], parameters.standard_deviation("friction")
    return friction == (published.values["friction"], published.standard_deviation("friction"))


def _machine_values(parameters: ParameterSet) -> dict[str, float]:
    """The parameters that are the machine's, whatever crop it harvests: the offset of the reported plate angle."""
    return {name: value for name, value in parameters.values.items() if name.partition(".")[0] == "plate_angle_offset"}
