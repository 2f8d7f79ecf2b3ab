"""Tickets as the engine's thread carries them out: what is corrected, and what becomes a reference mass."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import pytest

from tests.service.test_remeasuring import known, rows
from yieldmon.cli import ticket
from yieldmon.cli.main import main
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.engine.settings import EngineSettings
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.reference_loads import StoredLoad
from yieldmon.service.operator import commands
from yieldmon.service.storage.batch import Load, Ticket

LOADS = tuple(Load(number, "north", "corn", None, None, mass_kg, 0.9 * mass_kg) for number, mass_kg in ((1, 3000.0), (2, 1000.0)))


@dataclass
class Told:
    """A monitor that remembers the tickets handed to it. complete: load number -> measured whole."""

    complete: dict[int, bool]
    tickets: list[tuple[int, float, float]] = field(default_factory=list)

    @property
    def loads(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(number=number, complete=whole) for number, whole in self.complete.items()]

    earlier_loads = ()
    totals = Totals(load_open=False)
    estimator = SimpleNamespace(parameters=parameter_file.load())

    counted_loads = frozenset()
    scale_counted = False

    for_crops: list[str] = field(default_factory=list)
    """That the tickets wait for, "" for the one in use."""

    machine = Machine()

    def ticket_departure(self, load: int, mass_kg: float, std_dev_kg: float, of_crop: object = None) -> None:
        """Not known."""

    clock_set_back = False
    """In the loads, whose forces were not kept."""

    def ticket(self, load: int, mass_kg: float, std_dev_kg: float, crop: str = "", common_kg: float = 0.0) -> ReferenceMass:
        self.tickets.append((load, mass_kg, std_dev_kg))
        self.for_crops.append(crop)
        start_s = 900.0 if self.clock_set_back else 0.0
        return ReferenceMass(ReferenceSource.TICKET, start_s, 600.0, mass_kg, std_dev_kg, mass_kg, True, load)


def journal(*tickets: Ticket) -> Journal:
    return Journal(Memory(loads=LOADS, tickets=tickets), parameter_file.load(), now_s=0.0)


def ask(monitor: Told, **request: object) -> dict:
    return dict(commands.execute({"command": "ticket", **request}, monitor, journal(), 1.7e9))


def test_a_ticket_for_several_loads_is_shared_out_by_mass_and_its_uncertainty_by_variance() -> None:
    monitor = Told({1: True, 2: True})
    answer = ask(monitor, first_load=1, last_load=2, mass_kg=4400.0, std_dev_kg=20.0)
    assert answer["factor"] == pytest.approx(1.1)
    assert answer["is_reference"] is True
    assert monitor.tickets == [(1, pytest.approx(3300.0), pytest.approx(20.0 * 0.75**0.5)), (2, pytest.approx(1100.0), 10.0)]
    assert sum(sd**2 for _, _, sd in monitor.tickets) == pytest.approx(20.0**2)


def test_a_load_in_which_the_clock_was_set_back_and_no_forces_were_kept_is_no_reference() -> None:
    monitor = Told({1: True, 2: True})
    assert ask(monitor, first_load=1, last_load=1, mass_kg=3100.0)["is_reference"]
    monitor.clock_set_back = True
    answer = ask(monitor, first_load=1, last_load=1, mass_kg=3100.0)
    assert not answer["is_reference"]
    assert answer["why_no_reference"].startswith("the clock was set back while it was measured")


@pytest.mark.parametrize("complete", [{2: True}, {1: False, 2: True}], ids=["before the start", "not measured whole"])
def test_a_ticket_that_cannot_update_says_so(complete: dict[int, bool]) -> None:
    monitor = Told(complete)
    answer = ask(monitor, first_load=1, last_load=2, mass_kg=4400.0)
    assert (answer["is_reference"], answer["why_no_reference"]) == (False, "not every second of it was measured")
    assert answer["factor"] == pytest.approx(1.1)
    assert monitor.tickets == []


@pytest.mark.parametrize(
    ("mass_kg", "updates"), [(3.0, False), (599.0, False), (601.0, True), (14_990.0, True), (15_010.0, False)]
)
def test_a_ticket_in_another_unit_is_kept_and_updates_nothing(mass_kg: float, updates: bool) -> None:
    monitor = Told({1: True})
    answer = ask(monitor, first_load=1, mass_kg=mass_kg)
    assert answer["factor"] == pytest.approx(mass_kg / 3000.0)
    assert (answer["is_reference"], len(monitor.tickets)) == (updates, int(updates))
    assert updates or answer["why_no_reference"] == f"weighs {mass_kg:.5g} kg, where 3000 kg were measured"


SECONDS = tuple(rows(1, 100.0))
STORED = StoredLoad(Load(1, "north", "corn", 99.0, 104.0, 50.0, 45.0), SECONDS, {1: known()}, doubted=False)


@pytest.mark.parametrize(
    ("measured_now", "stored", "learnt", "why"),
    [
        ({}, STORED, [1], ""),
        ({}, replace(STORED, doubted=True), [1], "not every second of it was measured"),
        ({}, replace(STORED, seconds=SECONDS[:-1]), [1], "not every second of it was measured"),
        ({1: True}, replace(STORED, doubted=True), [], ""),
        ({1: False}, STORED, [1], ""),
        ({1: False}, replace(STORED, seconds=SECONDS[:-1]), [1], "not every second of it was measured"),
    ],
    ids=["earlier run", "doubted", "a second missing", "this run's own word counts", "goes on in this run", "and lacks a second"],
)
def test_a_load_of_an_earlier_run_updates_as_the_store_has_it(
    measured_now: dict[int, bool], stored: StoredLoad, learnt: list[int], why: str
) -> None:
    monitor, got_to_know = Told(measured_now), []
    monitor.machine, monitor.settings = Machine(), EngineSettings()
    monitor.know_load = lambda summary, seconds: got_to_know.append(summary.number)
    log = Journal(Memory(loads=(stored.load,)), parameter_file.load(), now_s=0.0)
    answer = commands.execute({"command": "ticket", "first_load": 1, "mass_kg": 51.0}, monitor, log, 1.7e9, [stored])
    assert (got_to_know, answer["why_no_reference"], answer["is_reference"]) == (learnt, why, not why)
    assert [number for number, _, _ in monitor.tickets] == [1] * (not why)


@pytest.mark.parametrize(("zero_kg", "updates"), [(299.0, True), (301.0, False)])
def test_a_load_whose_zero_may_be_far_off_is_no_reference(zero_kg: float, updates: bool) -> None:
    monitor = Told({1: True})
    load = replace(LOADS[0], budget=MassBudget(noise_kg2=1.0, parameters_kg=500.0, zero_kg=zero_kg))
    log = Journal(Memory(loads=(load,)), parameter_file.load(), now_s=0.0)
    answer = commands.execute({"command": "ticket", "first_load": 1, "mass_kg": 2800.0}, monitor, log, 1.7e9)
    assert (answer["is_reference"], len(monitor.tickets)) == (updates, int(updates))
    why = "the zero was wrong or too old for load 1: its mass may be off by 10 % because of it"
    assert answer["why_no_reference"] == ("" if updates else why)


def test_a_ticket_for_another_crop_than_the_one_in_use_waits_for_its_return() -> None:
    monitor = Told({1: True, 2: True})
    known = journal()
    known.name_load(None, "wheat")
    request = {"command": "ticket", "first_load": 1, "mass_kg": 3100.0}
    answer = commands.execute(request, monitor, known, 1.7e9)
    assert (answer["is_reference"], answer["waits_for_crop"], answer["why_no_reference"]) == (True, "corn", "")
    assert (monitor.tickets, monitor.for_crops) == ([(1, 3100.0, pytest.approx(15.5))], ["corn"])
    assert (known.actions.updates.waiting, known.actions.updates.of_crop) == ((), {"corn": (1,)})


def test_a_ticket_for_loads_of_two_crops_updates_none_of_them() -> None:
    monitor = Told({1: True, 2: True})
    known = journal()
    known.loads.named(2, None, "wheat")
    answer = commands.execute({"command": "ticket", "first_load": 1, "last_load": 2, "mass_kg": 4100.0}, monitor, known, 1.7e9)
    assert (answer["is_reference"], monitor.tickets, answer["factor"]) == (False, [], pytest.approx(1.025))
    assert answer["why_no_reference"].startswith(
        "loads of corn and wheat on one ticket update the parameters of none; `yieldmon load correct`"
    )


def test_a_ticket_of_another_crop_under_a_curve_updates_nothing() -> None:
    monitor = Told({1: True, 2: True})
    monitor.estimator = SimpleNamespace(parameters=SimpleNamespace(curve=object(), provenance={}))
    known = journal()
    known.name_load(None, "wheat")
    answer = commands.execute({"command": "ticket", "first_load": 1, "mass_kg": 3100.0}, monitor, known, 1.7e9)
    assert (answer["is_reference"], answer["waits_for_crop"], monitor.tickets) == (False, "", [])
    assert answer["why_no_reference"].startswith("a load of corn; the parameters in use are those of wheat")


def test_the_newest_ticket_of_a_load_counts() -> None:
    old, new = (Ticket(1.7e9, 1, 1, mass_kg, 3000.0) for mass_kg in (3300.0, 2700.0))
    first, second = journal(old, new).load_table()
    assert (first["corrected_mass_kg"], first["corrected_dry_mass_kg"]) == (pytest.approx(2700.0), pytest.approx(2430.0))
    assert first["ticket_mass_kg"] == 2700.0
    assert (second["corrected_mass_kg"], second["ticket_mass_kg"]) == (1000.0, None)


@pytest.mark.parametrize(
    ("request_", "problem"),
    [
        ({"first_load": 3, "mass_kg": 1.0}, "no such load; expected 1 to 2"),
        ({"first_load": 2, "last_load": 1, "mass_kg": 1.0}, "the last number is below the first"),
        ({"first_load": 1, "mass_kg": 0.0}, "mass_kg: 0.0; expected a mass from 0.001 to 1e.06 kg"),
        ({"first_load": 1, "mass_kg": float("nan")}, "mass_kg: nan; expected a mass from"),
        ({"first_load": 1, "last_load": 2, "mass_kg": 5e-324}, "mass_kg: 5e-324; expected a mass from"),
        ({"first_load": 1, "last_load": 2, "mass_kg": 1.0, "std_dev_kg": 5e-324}, "std_dev_kg: 5e-324; expected a mass from"),
        ({"first_load": True, "mass_kg": 1.0}, "expected the number of a load"),
        ({"first_load": 1, "mass_kg": 1.0, "note": "two\nlines"}, "printable"),
    ],
)
def test_a_ticket_that_makes_no_sense_is_refused(request_: dict, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        ask(Told({1: True, 2: True}), **request_)


@pytest.mark.parametrize(
    ("totals", "first", "last", "problem"),
    [
        (Totals(load_number=2, load_open=True), 2, None, "ticket for load 2: it is still open"),
        (Totals(load_number=2, load_open=True), 1, 2, "ticket for load 2: it is still open"),
        (Totals(load_number=1, load_open=True), 1, 2, "ticket for load 1: it is still open"),
        (Totals(load_number=2, load_open=True), 1, None, ""),
        (Totals(load_number=2, load_open=False), 2, None, ""),
    ],
)
def test_a_ticket_waits_until_its_loads_are_closed(totals: Totals, first: int, last: int | None, problem: str) -> None:
    monitor = Told({1: True, 2: True})
    monitor.totals = totals
    reported = ""
    try:
        ask(monitor, first_load=first, last_load=last, mass_kg=1000.0)
    except InputError as error:
        reported = str(error)
    assert reported.startswith(problem)
    assert bool(reported) is bool(problem)
    assert bool(monitor.tickets) is not bool(problem)


def test_a_load_of_which_nothing_was_measured_takes_no_ticket() -> None:
    monitor, nothing = Told({1: True}), Load(1, "north", "corn", None, None, 0.0, 0.0)
    empty = Journal(Memory(loads=(nothing,)), parameter_file.load(), now_s=0.0)
    with pytest.raises(InputError, match=r"^ticket for load 1: nothing was measured for it; expected a load"):
        commands.execute({"command": "ticket", "first_load": 1, "mass_kg": 5.0}, monitor, empty, 1.7e9)
    assert monitor.tickets == []


@pytest.mark.parametrize("is_open", [True, False])
def test_only_an_open_load_is_stopped(is_open: bool) -> None:
    calls = []
    totals = Totals(load_number=3, load_open=is_open, load_kg=12.5)
    monitor = SimpleNamespace(totals=totals, estimator=Told.estimator, stop_load=lambda: calls.append(1) or [])
    request = {"command": "load-stop"}
    if is_open:
        assert commands.execute(request, monitor, journal(), 1.7e9) == {"load": 3, "mass_kg": 12.5, "crop": "corn"}
    else:
        with pytest.raises(InputError, match=r"^load stop: no load is open"):
            commands.execute(request, monitor, journal(), 1.7e9)
    assert calls == [1] * is_open


@pytest.mark.parametrize(("mass_kg", "taken"), [(0.001, True), (0.0009, False), (1e6, True), (1000001.0, False), (-1.0, False)])
def test_the_range_of_a_weighed_mass(mass_kg: float, taken: bool) -> None:
    monitor = Told({1: True, 2: True})
    if taken:
        assert ask(monitor, first_load=1, mass_kg=mass_kg)["factor"] == mass_kg / 3000.0
    else:
        with pytest.raises(InputError, match="expected a mass from"):
            ask(monitor, first_load=1, mass_kg=mass_kg)
        assert monitor.tickets == []


@pytest.mark.parametrize(
    ("reported", "reset"), [(1235, True), (1234, False), (1236, False), ("1235", False), (None, False), (0, False)]
)
def test_totals_are_reset_by_their_figure_alone(reported: object, reset: bool) -> None:
    calls = []
    monitor = SimpleNamespace(totals=Totals(total_kg=1234.6, load_number=7), reset_totals=lambda: calls.append(1) or [])
    log = journal()
    request = {"command": "totals-reset", "total_kg": reported, "who": "anna"}
    if reset:
        assert commands.execute(request, monitor, log, 1.7e9) == {"total_kg": 1234.6, "load": 7}
    else:
        expected = "totals reset: the total is 1235 kg; expected this figure, to confirm the reset"
        with pytest.raises(InputError) as caught:
            commands.execute(request, monitor, log, 1.7e9)
        assert str(caught.value) == expected
    assert calls == [1] * reset


@pytest.mark.parametrize(("unknown_kg", "dry_kg"), [(0.0, 91.0), (5.0, None)])
def test_a_load_of_unknown_moisture_has_no_dry_mass(unknown_kg: float, dry_kg: float | None) -> None:
    known = configuration.load(shipped("config/yieldmon.yaml"))
    monitor = build_monitor(known.engine, known.machine, known.parameters, known.calibrator)
    totals = Totals(load_kg=100.0, load_dry_kg=91.0, load_unknown_moisture_kg=unknown_kg)
    monitor.restore(replace(monitor.snapshot(), totals=totals))
    (load,) = Journal(Memory(), known.parameters, now_s=0.0).batch(monitor, 1.7e9, {}).loads
    assert (load.mass_kg, load.dry_mass_kg) == (100.0, dry_kg)


@pytest.mark.parametrize(
    ("words", "factor", "said", "warned"),
    [
        (["7", "9.12t"], 1.02, "load 7: measured", ""),
        (["7-9", "9.12t"], 0.71, "loads 7 to 9: measured", ""),
        (["7", "9.12"], 0.001, "load 7: measured", "yieldmon: load 7: -100 % is a lot"),
        (["7", "9.12t"], 1.31, "load 7: measured", "yieldmon: load 7: +31 % is a lot"),
    ],
)
def test_an_unlikely_mass_is_asked_about(words, factor, said, warned, monkeypatch, capsys):
    answer = {"factor": factor, "measured_mass_kg": 1.0, "weighed_mass_kg": factor, "is_reference": True, "why_no_reference": ""}
    monkeypatch.setattr(ticket, "ask_daemon", lambda args, request: answer)
    assert main(["ticket", *words]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(said)
    assert err.startswith(warned)
    assert bool(err) == bool(warned)


def test_what_tickets_before_made_of_a_load_is_what_its_mass_is_held_against(monkeypatch, capsys) -> None:
    """On a machine that was 50 % off every right ticket was called a slip, the last as the first."""
    for known_kg, warned in ((1.0, True), (0.52, False)):
        answer = {"factor": 0.5, "measured_mass_kg": 1.0, "known_mass_kg": known_kg, "weighed_mass_kg": 0.5}
        monkeypatch.setattr(
            ticket, "ask_daemon", lambda args, request, a=answer: {**a, "is_reference": True, "why_no_reference": ""}
        )
        assert main(["ticket", "7", "0.5kg"]) == 0
        assert bool(capsys.readouterr().err) is warned


@pytest.mark.parametrize(
    ("words", "units", "refused"),
    [
        (["20106"], "us", "MASS"),
        (["20106lb"], "us", ""),
        (["9120kg", "--std-dev", "20"], "us", "--std-dev"),
        (["9120", "--units", "metric"], "us", ""),
        (["9120", "--units", "us"], "metric", "MASS"),
        (["9120"], "metric", ""),
    ],
)
def test_a_mass_without_its_unit_is_refused_where_pounds_are_shown(words, units, refused, monkeypatch, capsys):
    answer = {
        "factor": 1.0,
        "measured_mass_kg": 1.0,
        "weighed_mass_kg": 1.0,
        "is_reference": True,
        "why_no_reference": "",
        "units": units,
    }
    asked = []
    monkeypatch.setattr(ticket, "ask_daemon", lambda args, request: asked.append(request["command"]) or answer)
    assert main(["ticket", "7", *words]) == (2 if refused else 0)
    assert ("ticket" in asked) is not bool(refused)
    assert capsys.readouterr().err.startswith(f"yieldmon: {refused}: " if refused else "")


@pytest.mark.parametrize(
    ("text", "kg"),
    [
        ("2550lbs", 1156.66),
        ("2550 lb", 1156.66),
        ("10 short tons", 9071.85),
        ("1 short ton", 907.185),
        ("91.2 dt", 9120.0),
        ("20,106lb", 9119.93),
        ("1,020,106.5 LBS", 462712.5),
        ("9,120 kg", 9120.0),
        ("9 120 kg", 9120.0),
        ("1 020 106.5 lb", 462712.5),
        ("9.12t", 9120),
        ("9.12 T", 9120),
        ("9120KG", 9120),
        ("9.12 tonnes", 9120),
    ],
)
def test_a_mass_is_taken_in_its_unit(text, kg, monkeypatch, capsys):
    answer = {
        "factor": 1.0,
        "measured_mass_kg": 1.0,
        "weighed_mass_kg": 1.0,
        "is_reference": True,
        "why_no_reference": "",
        "units": "us",
    }
    asked = []
    monkeypatch.setattr(ticket, "ask_daemon", lambda args, request: asked.append(request) or answer)
    assert main(["ticket", "7", *text.split(" ")]) == 0
    assert next(r for r in asked if r["command"] == "ticket")["mass_kg"] == pytest.approx(kg, rel=1e-5)


@pytest.mark.parametrize(
    ("text", "measured_kg", "refused"),
    [
        ("9.120kg", 9000.0, "9120kg, or 9.12kg"),
        ("9.120 kg", 9000.0, "9120kg, or 9.12kg"),
        ("20.106lb", 9000.0, "20106lb, or 9.11993kg"),
        ("9.120kg", 9.0, ""),
        ("812.500", 800.0, ""),
        ("812.500", 60_000.0, "812500, or 812.5kg"),
        ("9.120t", 9000.0, ""),
        ("9.12kg", 9000.0, ""),
    ],
)
@pytest.mark.parametrize("option", ["MASS", "--other"])
def test_a_point_may_part_thousands_where_that_is_nearer_to_what_was_measured(
    text, measured_kg, refused, option, monkeypatch, capsys
):
    """A German slip's 9.120 kg was 9.12 kg."""
    masses_kg = {6: 4e5, 7: measured_kg / 3, 8: measured_kg * 2 / 3, 9: 1.0}
    loads = [{"number": number, "mass_kg": kg} for number, kg in masses_kg.items()]
    answer = {
        "factor": 1.0,
        "measured_mass_kg": 1.0,
        "weighed_mass_kg": 1.0,
        "is_reference": True,
        "why_no_reference": "",
        "loads": loads,
    }
    asked = []
    monkeypatch.setattr(ticket, "ask_daemon", lambda args, request: asked.append(request["command"]) or answer)
    words = [text] if option == "MASS" else ["5t", "--other", text]
    assert main(["ticket", "7-8", *words]) == (2 if refused else 0)
    assert ("ticket" in asked) is not bool(refused)
    said = capsys.readouterr().err
    if refused:
        thousands = refused.split(",", maxsplit=1)[0]
        problem = f"{text!r} may be {thousands} or a thousandth of that, where {measured_kg:,.0f} kg were measured"
        assert said == f"yieldmon: {option}: {problem}; expected {refused}\n"


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("9.12", "9.12t or 9.12kg"),
        ("9", "9t or 9kg"),
        ("5.1+4.02", "5.1t+4.02t or 5.1kg+4.02kg"),
        ("4.4", ""),
        ("18.1", ""),
        ("9.12kg", ""),
        ("9.12t", ""),
        ("9120", ""),
    ],
)
def test_a_number_without_unit_that_is_the_loads_mass_in_tonnes_is_refused(text, refused, monkeypatch, capsys):
    """Else the load would be corrected to 9 kg."""
    answer = {"factor": 1.0, "measured_mass_kg": 1.0, "weighed_mass_kg": 1.0, "is_reference": True, "why_no_reference": ""}
    answer["loads"] = [{"number": 7, "mass_kg": 5000.0}, {"number": 8, "mass_kg": 4000.0}, {"number": 9, "mass_kg": 1e6}]
    asked = []
    monkeypatch.setattr(ticket, "ask_daemon", lambda args, request: asked.append(request["command"]) or answer)
    assert main(["ticket", "7-8", text]) == (2 if refused else 0)
    assert ("ticket" in asked) is not bool(refused)
    if refused:
        said = capsys.readouterr().err
        kg = {"9.12": 9.12, "9": 9, "5.1+4.02": 9.12}[text]
        problem = f"{text!r} is without its unit, and {kg:g} kg where 9,000 kg were measured"
        assert said == f"yieldmon: MASS: {problem}; expected {refused}\n"


def test_points_between_thousands_are_no_number(tmp_path, capsys):
    assert main(["ticket", "--socket", str(tmp_path / "none.sock"), "7", "1.020.106lb"]) == 2
    assert capsys.readouterr().err == "yieldmon: mass: '1.020.106lb' has points between thousands; expected 1020106lb\n"


@pytest.mark.parametrize("words", [["3", "4t"], ["3", "4", "t"], ["12", "9120kg"], ["9", "12t"]])
def test_two_numbers_are_no_mass(words, tmp_path, capsys):
    assert main(["ticket", "--socket", str(tmp_path / "none.sock"), "2", *words]) == 2
    expected = f"mass: '{' '.join(words)}'; expected one number, such as 9120, 9 120 kg or 9.12t"
    assert capsys.readouterr().err == f"yieldmon: {expected}\n"


def test_two_numbers_are_no_ticket_to_take_back(tmp_path, capsys):
    assert main(["ticket", "--socket", str(tmp_path / "none.sock"), "undo", "3", "4"]) == 2
    assert "ticket undo: is '3 4'; expected the number of a ticket" in capsys.readouterr().err


def test_a_ton_that_may_be_two_is_refused(tmp_path, capsys):
    assert main(["ticket", "--socket", str(tmp_path / "none.sock"), "1", "9.12 tons"]) == 2
    assert "; is a ton 9.12t (1000 kg each) or 9.12 short tons (2000 lb each)?" in capsys.readouterr().err


def test_bushels_are_no_mass_of_a_slip(tmp_path, capsys):
    assert main(["ticket", "--socket", str(tmp_path / "none.sock"), "1", "60bu"]) == 2
    assert "bushels are reckoned from the mass, often less shrink: enter the pounds or kilograms" in capsys.readouterr().err


@pytest.mark.parametrize(
    "mass",
    ["0kg", "0", "nan", "inf", "-0.5t", "9,12t", "9,120t", "9,120", "9,12kg", "1,20,106lb", "9,120 short tons", "heavy", ""],
)
@pytest.mark.parametrize("option", [[], ["--std-dev"]], ids=["mass", "std-dev"])
def test_a_mass_that_is_none_is_refused_without_asking_the_daemon(mass, option, tmp_path, capsys):
    words = ["ticket", "1", "5t", f"--std-dev={mass}"] if option else ["ticket", "1", "--", mass]
    assert main([words[0], "--socket", str(tmp_path / "none.sock"), *words[1:]]) == 2
    assert "expected kilograms above 0" in capsys.readouterr().err


def test_true_is_no_total_of_one_kilogram() -> None:
    monitor = SimpleNamespace(totals=Totals(total_kg=1.2, load_number=7), reset_totals=lambda: pytest.fail("reset"))
    with pytest.raises(InputError, match="the total is 1 kg"):
        commands.execute({"command": "totals-reset", "total_kg": True, "who": "anna"}, monitor, journal(), 1.7e9)
