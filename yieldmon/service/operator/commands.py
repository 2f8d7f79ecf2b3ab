"""What an operator can ask of a running daemon, carried out on the engine's thread."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from yieldmon.documents.calibrations import Calibrations, CalibrationsRestarted
from yieldmon.documents.loads import Loads, LoadsCorrected, LoadStarted, LoadStopped
from yieldmon.documents.tickets import Tickets
from yieldmon.documents.undo import CalibrationUndone, TicketUndone
from yieldmon.documents.zero import ZeroStarted, ZeroUndone
from yieldmon.engine.mass.load_summary import LoadClosed, LoadOpened
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.sources import THOUSAND_KERNELS_G
from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.files.crops import crops, misspelt, shipped_name
from yieldmon.service.assembly import calibration_age_s, set_grain
from yieldmon.service.history import load_names, undo
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.reference_loads import MOST_LOADS, StoredLoad
from yieldmon.service.operator.control_protocol import Answer
from yieldmon.service.operator.order import Order, covered_loads
from yieldmon.service.operator.requests import Request
from yieldmon.service.operator.ticket_entry import enter_ticket
from yieldmon.service.storage import ledger
from yieldmon.service.storage.empty_loads import empty_loads, without_empty

QUERIES = frozenset({"status", "loads", "tickets", "calibrations"})
"""Commands that change nothing."""
UPDATE_AGAIN = frozenset({"ticket-undo", "calibration-undo", "load-correct"})
"""Commands after which standing tickets may update the parameters again."""


def execute(
    request: Mapping[str, Any], monitor: Monitor, journal: Journal, now_s: float, stored: Sequence[StoredLoad] = ()
) -> Answer:
    """Carries out one request. stored: loads that a ticket names, as the store has them. Raises InputError when it cannot be."""
    name = request["command"]
    if name not in _COMMANDS:
        raise InputError("command", repr(name), f"one of status, {', '.join(_COMMANDS)}")
    command, arguments = _COMMANDS[name]
    checked = Request(request)
    checked.only(name, arguments)
    order = Order(request=checked, monitor=monitor, journal=journal, who=checked.who, now_s=now_s, stored=stored)
    return command(order)


def ticketed_loads(request: Mapping[str, Any]) -> range:
    """Numbers of the loads that a ticket or a correction names; none for another request, or one that makes no sense."""
    first, last = request.get("first_load"), request.get("last_load")
    last = first if last is None else last
    if request.get("command") not in ("ticket", "load-correct") or not isinstance(first, int) or not isinstance(last, int):
        return range(0)
    return range(first, last + 1) if 0 <= first <= last < first + MOST_LOADS else range(0)


def measures_again(request: Mapping[str, Any]) -> bool:
    """Whether a request measures loads again by the seconds in the store, at once."""
    return request.get("command") == "load-correct" and request.get("crop") is not None


def summary(status: Mapping[str, Any]) -> str:
    """One line for the service manager."""
    last = status["windows"][-1] if status["windows"] else None
    flow = last["mass_flow_kg_s"] if last is not None else None
    rate = f" {flow:.1f} kg/s," if flow is not None else ","
    faults = ", ".join(fault["code"] for fault in status["faults"])
    return f"{status['state']}{rate} load {status['load']['number']}: {status['load']['mass_kg']:.0f} kg" + (
        f"; {faults}" if faults else ""
    )


def _load_start(order: Order) -> LoadStarted:
    monitor, journal = order.monitor, order.journal
    request = order.request
    weight_g = request.mass_or_none("thousand_kernel_weight_g", *THOUSAND_KERNELS_G, "g")
    if weight_g is not None and monitor.waveform is None:
        raise InputError("thousand_kernel_weight_g", "has no effect", "waveform.enabled: true in the configuration")
    field, crop = request.name("field"), _crop_named(request, journal)
    if weight_g is not None or (crop is not None and crop != journal.crop):
        # What was entered for one crop's kernels does not hold for another's.
        journal.kernel_weight_g = weight_g
    in_use = monitor.estimator.parameters
    # A curve is one grain's: another crop's parameters would not give the flow.
    before = journal.parameters.crop_of(in_use, journal.crop)
    shipped = crop in crops() and in_use.curve is None
    known = not crop or shipped or crop == in_use.provenance.get("crop") or journal.parameters.keeps(crop)
    last, chosen = monitor.totals.load_number, None
    if crop and in_use.curve is None:
        chosen = journal.parameters.change_crop(crop, in_use, journal.crop, request.who, last)
    if chosen is not None:
        monitor.change_crop(
            estimator_of(monitor.machine, chosen), calibration_age_s(chosen, order.now_s), before=before, now=crop or ""
        )
        journal.actions.updates.change_crop(before, crop or "")
    journal.name_load(field, crop)
    journal.happened(monitor.start_load())
    set_crop(monitor, journal)
    parameters = monitor.estimator.parameters
    changed = chosen is not None and known
    return {
        "load": monitor.totals.load_number,
        "field": journal.field,
        "crop": journal.crop,
        "parameters": {
            "version": parameters.version,
            "crop": parameters.provenance.get("crop"),
            "changed": changed,
            "carried_from": parameters.carried_from,
        },
        "crop_known": known,
    }


def _crop_named(request: Request, journal: Journal) -> str | None:
    """The crop as it is kept, None where the request names none. Raises InputError for a slip of a finger: what is weighed and
    measured under that name would be lost to the crop that was meant."""
    name = request.name("crop")
    if name is None:
        return None
    meant = None if journal.parameters.keeps(name) else misspelt(name)
    if meant is not None:
        raise InputError("crop", f"{name!r} is not a known crop", f"{meant}; or, for another crop, a name that differs more")
    return shipped_name(name) or name


def set_crop(monitor: Monitor, journal: Journal) -> None:
    """Dry mass from now on at the market moisture of the crop in use, and the weight of its kernels."""
    set_grain(monitor, journal.crop_in_use(monitor.estimator.parameters), journal.kernel_weight_g)


def _totals_reset(order: Order) -> Answer:
    monitor, journal = order.monitor, order.journal
    before_kg = monitor.totals.total_kg
    given = order.request.values.get("total_kg")
    if isinstance(given, bool) or given != round(before_kg):
        raise InputError("totals reset", f"the total is {before_kg:.0f} kg", "this figure, to confirm the reset")
    journal.actions.add(ledger.TOTALS_RESET, order.who, {"total_kg": before_kg}, order.now_s)
    journal.happened(monitor.reset_totals())
    return {"total_kg": before_kg, "load": monitor.totals.load_number}


def _load_stop(order: Order) -> LoadStopped:
    monitor, journal = order.monitor, order.journal
    if not monitor.totals.load_open:
        raise InputError("load stop", "no load is open", "one that `yieldmon load start` began")
    journal.happened(monitor.stop_load())
    crop = journal.crop_in_use(monitor.estimator.parameters)
    return {"load": monitor.totals.load_number, "mass_kg": monitor.totals.load_kg, "crop": crop}


def _load_correct(order: Order) -> LoadsCorrected:
    request, monitor, journal = order.request, order.monitor, order.journal
    first, last = request.load_numbers()
    field, crop = request.name("field"), _crop_named(request, journal)
    if field is None and crop is None:
        raise InputError("load correct", "names nothing to correct", "a crop or a field")
    opened = monitor.open_load
    if opened is not None and first <= opened.number <= last:
        if crop:
            expected = f"another field, or `yieldmon load start --crop {crop}`, then correct load {opened.number}"
            raise InputError(f"load {opened.number}", "is still open", expected)
        journal.loads.measured(opened, journal.field, journal.crop)
    wanted = load_names.Correction(covered_loads(journal, first, last, "load"), field, crop)
    of_crop = load_names.correct(wanted, order)
    if opened is not None and wanted.loads[-1].number == opened.number:
        journal.name_load(field, None)
    goes_on = journal.crop_in_use(monitor.estimator.parameters)
    newest = not monitor.totals.load_open and last >= monitor.totals.load_number
    answer: LoadsCorrected = {
        "first_load": wanted.loads[0].number,
        "last_load": wanted.loads[-1].number,
        "field": field,
        "crop": crop,
        "goes_on": goes_on if newest and crop and goes_on and goes_on.lower() != crop.lower() else "",
    }
    if of_crop is not None:
        answer |= {
            "measured_again": list(of_crop.measured_again),
            "not_measured_again": [{"load": load, "why": why} for load, why in sorted(of_crop.not_measured_again.items())],
            "updated_again": list(of_crop.updating.again),
            "not_updated_again": of_crop.updating.not_again,
            "taken_back": list(of_crop.taken_back),
        }
    return answer


def _loads(order: Order) -> Loads:
    journal = order.journal
    empty, rows = empty_loads(journal.loads), journal.load_table()
    return {"loads": rows if order.request.flag("all") else without_empty(rows, empty), "empty_loads": empty}


def _tickets(order: Order) -> Tickets:
    return {"tickets": order.journal.actions.ticket_table(order.monitor.doubted_loads)}


def _ticket_undo(order: Order) -> TicketUndone:
    number = order.request.number_of("ticket", "ticket")
    return undo.without_ticket(number, order)


def _calibrations(order: Order) -> Calibrations:
    journal = order.journal
    return {"calibrations": journal.parameters.table(order.monitor.estimator.parameters, journal.crop)}


def _calibration_undo(order: Order) -> CalibrationUndone:
    version = order.request.number_of("version", "version")
    return undo.without_version(version, order)


def _calibration_restart(order: Order) -> CalibrationsRestarted:
    monitor, journal = order.monitor, order.journal
    in_use, totals = monitor.estimator.parameters, monitor.totals
    if in_use.curve is not None:
        raise InputError("calibrations restart", "the flow comes from estimator_file", "another estimator_file, and a reload")
    history = journal.actions.history
    standing = sorted(n for n in history.references if n in history.updating)
    load = None
    if totals.load_open and totals.load_kg > 0.0:
        # Of a load that both measured nothing could be said.
        journal.happened(monitor.start_load())
        load = monitor.totals.load_number
    waiting = {n for numbers in journal.actions.updates.of_crop.values() for n in numbers}
    journal.actions.wait_no_more(sorted(waiting | {*journal.actions.unfinished}))
    chosen = journal.parameters.restart(in_use, journal.crop, order.who, order.request.name("note") or "change of the machine")
    crop = chosen.provenance.get("crop", "")
    return {
        "version": chosen.version, "before": in_use.version, "crop": crop, "load": load, "tickets": standing,
        "std_dev_pct": 100.0 * chosen.scale_error,
    }  # fmt: skip


def _zero(order: Order) -> ZeroStarted:
    monitor = order.monitor
    signs, against = monitor.signs_of_grain, monitor.signs_against_zero
    force = order.request.flag("force")
    if against and not force:
        raise InputError("zero", f"there is grain: {against}", "the elevator running empty; `yieldmon zero --force` if it does")
    if signs and not force:
        expected = "nothing on the plate; `yieldmon zero --force` if it is clean, as after a change of the sensor"
        raise InputError("zero", f"{signs}, without the paddle pulses of grain", expected)
    goes_on = monitor.calibrate_zero(despite_signs=force)
    order.journal.zero(order.who, against, order.now_s, goes_on=goes_on)
    return {"zero": "started; keep the elevator running empty"}


def _zero_undo(order: Order) -> ZeroUndone:
    monitor, journal = order.monitor, order.journal
    try:
        restored, events = monitor.undo_zero()
    except ValueError as error:
        raise InputError("zero --undo", str(error), "an undo after `yieldmon zero`") from error
    journal.happened(events)
    reported = {event.load.number for event in events if isinstance(event, LoadOpened | LoadClosed)}
    reported |= {monitor.totals.load_number} if monitor.totals.load_open else set()
    journal.zero_undone(order.who, restored, reported, order.now_s)
    return {"zero": "undone", "restored_kg": sum(missed.kg for missed in restored.values())}


def _sweep_start(order: Order) -> Answer:
    monitor = order.monitor
    if not monitor.settings.sweep.enabled:
        if monitor.estimator.parameters.curve is not None:
            raise InputError("sweep", "updates nothing: the flow comes from estimator_file", "the physical model")
        raise InputError("sweep", "switched off by sweep.enabled in the configuration", "`enabled: true` there, and a reload")
    monitor.request_sweep()
    wanted = monitor.settings.sweep
    conditions = (
        f"a flow of at least {wanted.min_flow_kg_s:g} kg/s and the elevator speed are steady for {wanted.steady_windows} s"
    )
    return {"sweep": f"as soon as {conditions} with the plate at home"}


def _sweep_abort(order: Order) -> Answer:
    return {"sweep": "ended" if order.monitor.abort_sweep() else "is not under way"}


_COMMANDS: Mapping[str, tuple[Callable[[Order], Answer], tuple[str, ...]]] = {
    "load-start": (_load_start, ("field", "crop", "thousand_kernel_weight_g")),
    "load-stop": (_load_stop, ()),
    "load-correct": (_load_correct, ("first_load", "last_load", "field", "crop")),
    "totals-reset": (_totals_reset, ("total_kg",)),
    "loads": (_loads, ("all",)),
    "ticket": (enter_ticket, ("first_load", "last_load", "mass_kg", "std_dev_kg", "other_kg", "other_std_dev_kg", "note")),
    "tickets": (_tickets, ()),
    "ticket-undo": (_ticket_undo, ("ticket",)),
    "calibrations": (_calibrations, ()),
    "calibration-undo": (_calibration_undo, ("version",)),
    "calibration-restart": (_calibration_restart, ("note",)),
    "zero": (_zero, ("force",)),
    "zero-undo": (_zero_undo, ()),
    "sweep-start": (_sweep_start, ()),
    "sweep-abort": (_sweep_abort, ()),
}
"""What carries out each, and the arguments that it takes."""
