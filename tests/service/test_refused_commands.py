"""What a running daemon refuses, word for word, and the last value on either side of each limit."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service.bench import Bench, running
from yieldmon.errors import InputError

CONFIGURATION = "bus: {transmit_max_age_s: 60}\nsweep: {enabled: false}\n"
VERBS = (
    "status, load-start, load-stop, load-correct, totals-reset, loads, ticket, tickets, ticket-undo, "
    "calibrations, calibration-undo, calibration-restart, zero, "
    "zero-undo, sweep-start, sweep-abort"
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Load 1 measured and ended, load 2 ended with nothing, load 3 open with grain in it."""
    with running(tmp_path_factory.mktemp("refused"), CONFIGURATION) as daemon:
        daemon.play(5.0, 0.0)
        daemon.play(2.0, 100.0)
        daemon.played()
        for verb in ("load-start", "load-start"):
            daemon.daemon.command({"command": verb})
        daemon.play(2.0, 100.0)
        daemon.played()
        yield daemon


def mass(value: object, key: str = "mass_kg", low: str = "0.001", high: str = "1e+06", unit: str = "kg") -> str:
    return f"{key}: {value!r}; expected a mass from {low} to {high} {unit}"


TICKET = {"command": "ticket", "first_load": 1, "mass_kg": 10.0}
OPEN = "ticket for load 3: it is still open, so more grain may come; expected `yieldmon load stop` first, or another load"
REFUSED = [
    ({"command": "dance"}, f"command: 'dance'; expected one of {VERBS}"),
    ({"command": "sweep-start"}, "sweep: switched off by sweep.enabled in the configuration; "
                                  "expected `enabled: true` there, and a reload"),
    ({"command": "zero-undo"}, "zero --undo: there is no zero calibration by an operator that could be undone; expected an undo "
                               "after `yieldmon zero`"),
    ({"command": "load-start", "field": "x" * 81},
     f"field: {repr('x' * 81)[:100]}; expected a name of at most 80 printable characters"),
    ({"command": "load-start", "crop": "a\nb"}, "crop: 'a\\nb'; expected a name of at most 80 printable characters"),
    ({"command": "load-start", "crop": 7}, "crop: 7; expected a name of at most 80 printable characters"),
    ({"command": "load-start", "crop": ""}, "crop: is empty; expected a name of at most 80 printable characters"),
    ({"command": "load-start", "field": "  "}, "field: is empty; expected a name of at most 80 printable characters"),
    ({"command": "load-correct", "first_load": 1, "crop": ""},
     "crop: is empty; expected a name of at most 80 printable characters"),
    ({"command": "load-correct", "first_load": 1, "field": "", "crop": "corn"},
     "field: is empty; expected a name of at most 80 printable characters"),
    ({**TICKET, "note": ""}, "note: is empty; expected a name of at most 80 printable characters"),
    ({"command": "load-start", "thousand_kernel_weight_g": 0.999}, mass(0.999, "thousand_kernel_weight_g", "1", "2000", "g")),
    ({"command": "load-start", "thousand_kernel_weight_g": 2001}, mass(2001, "thousand_kernel_weight_g", "1", "2000", "g")),
    ({"command": "load-start", "thousand_kernel_weight_g": 1},
     "thousand_kernel_weight_g: has no effect; expected waveform.enabled: true in the configuration"),
    ({"command": "load-start", "thousand_kernel_weight_g": 2000.0},
     "thousand_kernel_weight_g: has no effect; expected waveform.enabled: true in the configuration"),
    ({**TICKET, "mass_kg": 0.0009}, mass(0.0009)),
    ({**TICKET, "mass_kg": 1000000.5}, mass(1000000.5)),
    ({**TICKET, "mass_kg": True}, mass(True)),
    ({**TICKET, "mass_kg": "9"}, mass("9")),
    ({**TICKET, "mass_kg": float("nan")}, mass(float("nan"))),
    ({"command": "ticket", "first_load": 1}, mass(None)),
    ({**TICKET, "std_dev_kg": 0.0009}, mass(0.0009, "std_dev_kg")),
    ({**TICKET, "std_dev_kg": 10.5}, "std_dev_kg: is 10.5 kg, of 10 kg; expected the "
     "standard deviation of the weighing, below the mass"),
    ({**TICKET, "first_load": -1}, "first_load: -1; expected the number of a load"),
    ({**TICKET, "first_load": 1.0}, "first_load: 1.0; expected the number of a load"),
    ({**TICKET, "first_load": True}, "first_load: True; expected the number of a load"),
    ({**TICKET, "last_load": "2"}, "last_load: '2'; expected the number of a load"),
    ({**TICKET, "first_load": 0}, "ticket for load 0: no such load; expected 1 to 3"),
    ({**TICKET, "first_load": 4}, "ticket for load 4: no such load; expected 1 to 3"),
    ({**TICKET, "first_load": 2}, "ticket for load 2: nothing was measured for it; expected a load with a measured mass"),
    ({**TICKET, "first_load": 2, "last_load": 1}, "ticket for loads 2 to 1: the last number is below the first; "
     "expected the first load first"),
    ({**TICKET, "first_load": 3}, OPEN),
    ({**TICKET, "last_load": 3}, OPEN),
    ({**TICKET, "note": "x" * 81}, f"note: {repr('x' * 81)[:100]}; expected a name of at most 80 printable characters"),
    ({"command": "ticket-undo", "ticket": -1}, "ticket: -1; expected the number of a ticket"),
    ({"command": "calibration-undo", "version": None}, "version: None; expected the number of a version"),
]  # fmt: skip


@pytest.mark.parametrize(("request_", "says"), REFUSED, ids=[f"{number}" for number in range(len(REFUSED))])
def test_a_refusal_says_what_is_wrong_and_what_was_expected(bench: Bench, request_: dict[str, object], says: str) -> None:
    before = bench.status["load"], bench.daemon.command({"command": "tickets"})
    with pytest.raises(InputError) as refused:
        bench.daemon.command(request_)
    assert str(refused.value) == says
    assert (bench.status["load"], bench.daemon.command({"command": "tickets"})) == before


@pytest.mark.parametrize("off_kg", [1.0, -1.0])
def test_a_total_is_reset_only_with_its_own_figure(bench: Bench, off_kg: float) -> None:
    total_kg = bench.status["total"]["mass_kg"]
    says = f"totals reset: the total is {total_kg:.0f} kg; expected this figure, to confirm the reset"
    with pytest.raises(InputError) as refused:
        bench.daemon.command({"command": "totals-reset", "total_kg": round(total_kg) + off_kg})
    assert str(refused.value) == says


@pytest.mark.parametrize("mass_kg", [0.001, 1_000_000, 10.0])
def test_the_last_masses_that_a_ticket_may_have(bench: Bench, mass_kg: float) -> None:
    reported = bench.daemon.command({**TICKET, "mass_kg": mass_kg, "note": "x" * 80, "std_dev_kg": 0.001})
    assert (reported["weighed_mass_kg"], reported["first_load"], reported["last_load"]) == (mass_kg, 1, 1)
    assert reported["factor"] == pytest.approx(mass_kg / reported["measured_mass_kg"])
    undone = bench.daemon.command({"command": "ticket-undo", "ticket": reported["ticket"]})
    assert (undone["ticket"], undone["first_load"], undone["last_load"]) == (reported["ticket"], 1, 1)
    with pytest.raises(InputError, match=f"ticket {reported['ticket']}: is undone already"):
        bench.daemon.command({"command": "ticket-undo", "ticket": reported["ticket"]})


@pytest.mark.parametrize("command", VERBS.split(", ")[1:])
@pytest.mark.parametrize("argument", ["std_dev", "Force", ""])
def test_an_argument_that_a_command_does_not_have_is_refused(bench: Bench, command: str, argument: str) -> None:
    """A misspelt one (std_dev for std_dev_kg) would count as not given."""
    before = bench.status["load"], bench.daemon.command({"command": "tickets"})
    given = {**TICKET, "mass_kg": 10.0} if command == "ticket" else {"command": command}
    with pytest.raises(InputError) as refused:
        bench.daemon.command({**given, argument: 1})
    assert str(refused.value).startswith(f"{command}: takes no {argument!r}; expected ")
    assert (bench.status["load"], bench.daemon.command({"command": "tickets"})) == before


@pytest.mark.parametrize("given", ["yes", 1, 0.0, [], {}])
def test_a_switch_is_true_or_false(bench: Bench, given: object) -> None:
    with pytest.raises(InputError) as refused:
        bench.daemon.command({"command": "zero", "force": given})
    assert str(refused.value) == f"force: {given!r}; expected true or false"


def test_a_number_without_end_is_shown_in_part(bench: Bench) -> None:
    for request in ({"command": "ticket-undo", "ticket": -(10**400)}, {**TICKET, "mass_kg": 10**400}):
        with pytest.raises(InputError) as refused:
            bench.daemon.command(request)
        assert len(str(refused.value)) < 200
