"""What operators entered: which tickets still wait to be learnt from, or for their loads to be measured again."""

from __future__ import annotations

from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.files import parameter_file
from yieldmon.service.storage import ledger
from yieldmon.service.storage.batch import Ticket
from yieldmon.service.storage.ledger import LOAD_NAMES, PARAMETERS, PARAMETERS_UNDO, REMEASURED
from yieldmon.service.tickets.action_log import ActionLog


def test_tickets_that_update_wait_until_they_are_taken_or_taken_back() -> None:
    log = ActionLog((), (), 5.0)
    tickets = [Ticket(float(n), n, n, 100.0 + n, 99.0, "") for n in range(1, 4)]
    assert [log.ticket(ticket, is_reference=ticket.first_load != 2) for ticket in tickets] == [1, 2, 3]
    assert log.updates.waiting == (1, 3)
    assert log.undo_ticket(3, "somebody", 6.0) == tickets[2]
    assert log.updates.waiting == (1,)


def weighed(count: int) -> ActionLog:
    log = ActionLog((), (), 5.0)
    for number in range(1, count + 1):
        log.ticket(Ticket(float(number), number, number, 100.0 + number, 99.0, ""), is_reference=True)
    return log


def updated(log: ActionLog, version: int) -> None:
    """All tickets that wait led to one version."""
    references = tuple((n, 100.0 + n) for n in log.updates.waiting)
    numbers = log.take_behind(ParametersChanged(parameter_file.load(), "ticket", "", references=references))
    log.add(PARAMETERS, "", {"version": version, "from_version": version - 1, "origin": "ticket", "tickets": numbers})


def test_a_ticket_taken_back_while_loads_are_measured_again_leaves_those_of_the_others_to_be_measured_again() -> None:
    """Factors of a ticket that is gone do not stand, nor what it says of the loads of other tickets."""
    log = weighed(3)
    updated(log, 1)
    assert log.take_to_measure(1) == ((1, 2, 3), 1)
    log.undo_ticket(1, "somebody", 6.0)
    assert log.unfinished == (2, 3)
    log.remeasured((1, 2, 3), 1, {2: 1.1, 3: 1.2})
    assert (log.unfinished, log.history.ledger.factors) == ((2, 3), {})
    assert log.take_to_measure(1) == ((2, 3), 1)
    log.remeasured((2, 3), 1, {2: 1.1, 3: 1.2})
    assert (log.unfinished, log.history.ledger.factors) == ((), {2: 1.1, 3: 1.2})


def test_of_two_tickets_for_one_load_with_one_mass_each_is_behind_one_change() -> None:
    log = weighed(0)
    for time_s in (1.0, 2.0):
        log.ticket(Ticket(time_s, 4, 4, 101.0, 99.0, ""), is_reference=True)
    change = ParametersChanged(parameter_file.load(), "ticket", "", references=((4, 101.0),))
    assert [log.take_behind(change) for _ in range(3)] == [[1], [2], []]
    assert (log.updates.waiting, log.unfinished) == ((), (1, 2))


def test_a_version_of_an_earlier_store_names_what_had_updated_before_too() -> None:
    """It did for as long as loads were still to be measured again: an undo of the second leaves what the first led to."""
    log = weighed(2)
    log.add(PARAMETERS, "", {"version": 2, "from_version": 1, "origin": "ticket", "tickets": [1]})
    log.add(PARAMETERS, "", {"version": 3, "from_version": 2, "origin": "ticket", "tickets": [1, 2]})
    assert ledger.updated_by(log) == {2: (1,), 3: (2,)}
    log.add(PARAMETERS_UNDO, "", {"version": 2, "versions": [2, 3]})
    log.add(PARAMETERS, "", {"version": 4, "from_version": 1, "origin": "ticket", "tickets": [1, 2]})
    assert ledger.updated_by(log)[4] == (1, 2)


def test_tickets_of_which_nothing_came_are_taken_again_with_the_next() -> None:
    log = weighed(2)
    updated(log, 1)
    assert log.take_to_measure(1) == ((1, 2), 1)
    log.undo_ticket(2, "somebody", 6.0)
    log.ticket(Ticket(7.0, 3, 3, 103.0, 99.0, ""), is_reference=True)
    updated(log, 2)
    assert log.take_to_measure(2) == ((1, 3), 2)
    assert (log.updates.waiting, log.unfinished) == ((), (1, 3))


def test_a_load_given_another_crop_while_it_is_measured_again_keeps_what_that_crop_says() -> None:
    log = weighed(1)
    corrected = {
        "first_load": 1,
        "last_load": 1,
        "field": None,
        "crop": "wheat",
        "before": [{"load": 1, "field": "", "crop": "corn"}],
    }
    log.add(LOAD_NAMES, "somebody", corrected)
    updated(log, 1)
    log.take_to_measure(1)
    log.remeasured((1,), 1, {1: 1.1, 2: 1.2, 3: 1.3})
    assert log.history.ledger.factors == {1: 1.1, 2: 1.2, 3: 1.3}, "a correction from before it began is known to it"
    assert next_taken(log, 2) == ((2,), 2)
    log.add(LOAD_NAMES, "somebody", corrected | {"before": [{"load": 2, "field": "", "crop": "corn"}]})
    log.add(LOAD_NAMES, "somebody", {"field": "south", "crop": None, "before": [{"load": 3, "field": "", "crop": "corn"}]})
    log.remeasured_by_crop({2: 0.9}, 6.0)
    log.remeasured((2,), 2, {1: 1.15, 2: 1.25, 3: 1.35})
    assert log.history.ledger.factors == {1: 1.15, 2: 0.9, 3: 1.35}
    assert next_taken(log, 3) == ((3,), 3)
    log.add(LOAD_NAMES, "somebody", corrected | {"before": [{"load": 3, "field": "", "crop": "corn"}]})
    count = sum(action.kind == REMEASURED for action in log)
    log.remeasured((3,), 3, {3: 1.4})
    assert sum(action.kind == REMEASURED for action in log) == count, "a factor for no load is no action"


def next_taken(log: ActionLog, version: int) -> tuple[tuple[int, ...], int]:
    """A further ticket that led to this version."""
    number = 1 + sum(action.kind == ledger.TICKET for action in log)
    log.ticket(Ticket(7.0, number, number, 100.0 + number, 99.0, ""), is_reference=True)
    updated(log, version)
    return log.take_to_measure(version)


def test_a_refused_ticket_has_no_loads_measured_again() -> None:
    log = weighed(2)
    updated(log, 1)
    log.ticket(Ticket(7.0, 3, 3, 190.0, 99.0, ""), is_reference=True)
    assert log.updates.waiting == (3,)
    log.updates.handed_over()
    assert (log.updates.waiting, log.unfinished, log.take_to_measure(1)) == ((), (1, 2), ((1, 2), 1))


def test_what_was_measured_again_after_a_ticket_is_measured_once_more_where_it_went_with_another() -> None:
    """As where both updated within two seconds: the loads were measured again after the second alone."""
    log = weighed(1)
    updated(log, 2)
    assert next_taken(log, 3) == ((1, 2), 3)
    log.remeasured((1, 2), 3, {1: 1.1})
    log.measure_lost_again()
    assert not log.measuring_waits
    log.add(PARAMETERS_UNDO, "", {"version": 3, "versions": [3]})
    log.undo_ticket(2, "somebody", 6.0)
    log.measure_lost_again()
    assert (log.history.ledger.factors, log.take_to_measure(4)) == ({}, ((1,), 4))
