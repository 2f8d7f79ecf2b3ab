"""Whether a ticket can be a reference mass for the calibration."""

from __future__ import annotations

from collections.abc import Sequence

from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.service.history.reference_loads import reference
from yieldmon.service.history.request_context import RequestContext
from yieldmon.service.storage.batch import Load

_LARGEST_ZERO_SHARE = 0.1
"""Standard deviation of a load's mass through its zero, over its mass, above which the load says nothing of the scale."""


def why_no_reference(covered: Sequence[Load], context: RequestContext, crop: str) -> str:
    """Why a ticket is no reference mass for the calibration.

    The monitor gets to know those of its loads that an earlier run measured.

    Parameters
    ----------
    covered : sequence of Load
        The ticket's loads.
    context : RequestContext
    crop : str
        Whose parameters it is to update; "": those in use.

    Returns
    -------
    str
        "" where it is a reference mass.
    """
    return _of_another_crop(covered, context, crop) or _not_measured_whole(covered, context) or _zero_unknown(covered)


def _of_another_crop(covered: Sequence[Load], context: RequestContext, crop: str) -> str:
    journal = context.journal
    in_use = crop or journal.crop_in_use(context.monitor.estimator.parameters)
    named = sorted({journal.parameters.crop_of_load(load) for load in covered} - {""})
    if len({name.lower() for name in named}) > 1:
        both = " and ".join(named)
        return f"loads of {both} on one ticket update the parameters of none; `yieldmon load correct` if one has the wrong crop"
    other = next((found for found in named if in_use and found.lower() != in_use.lower()), None)
    if other is not None:
        return f"a load of {other}; the parameters in use are those of {in_use}; `yieldmon calibrate --loads` calibrates with it"
    return ""


def _not_measured_whole(covered: Sequence[Load], context: RequestContext) -> str:
    monitor, history = context.monitor, context.journal.actions.history
    whole = {load.number: load.complete for load in monitor.loads}
    # Only the store has every second of a load that goes on over a restart.
    earlier = {load.load.number: load for load in context.stored if not whole.get(load.load.number, False)}
    wanted = {load.number for load in covered}
    for number, load in earlier.items():
        if number not in wanted:
            continue
        found = reference(load, monitor.machine, monitor.settings)
        if min(found.versions, default=0) < history.calibrated_version:
            begun = history.updates[history.calibrated_version].document.get("origin")
            changed = "the machine was changed" if begun == ParameterOrigin.HARDWARE else "the parameter file in use"
            return f"load {number} was measured before {changed}"
        monitor.know_load(found.summary, found.seconds)
        whole[number] = found.summary.complete
    # The store may not have answered, as while it is written slowly: such loads are as they were known before.
    whole = {load.number: load.complete for load in monitor.earlier_loads if load.number not in earlier} | whole
    return "" if all(whole.get(load.number, False) for load in covered) else "not every second of it was measured"


def _zero_unknown(covered: Sequence[Load]) -> str:
    for load in covered:
        zero_kg = 0.0 if load.budget is None else load.budget.zero_kg
        if zero_kg > _LARGEST_ZERO_SHARE * load.mass_kg:
            share = 100.0 * zero_kg / load.mass_kg
            return f"the zero was wrong or too old for load {load.number}: its mass may be off by {share:.0f} % because of it"
    return ""
