"""What operators entered: which tickets still wait to be learnt from, or for their loads to be measured again."""

from __future__ import annotations

from yieldmon.service.storage.batch import Ticket
from yieldmon.service.storage.ledger import LOAD_NAMES, POSTING
from yieldmon.service.tickets.action_log import ActionLog


def test_tickets_that_update_wait_until_they_are_taken_or_taken_back() -> None:
    log = ActionLog((), (), 5.0)
    tickets = [Ticket(float(n), n, n, 100.0 + n, 99.0, "") for n in range(1, 4)]
    assert [log.ticket(ticket, is_reference=ticket.first_load != 2) for ticket in tickets] == [1, 2, 3]
    assert log.waiting == [1, 3]
    assert log.undo_ticket(3, "somebody", 6.0) == tickets[2]
    assert log.waiting == [1]


def weighed(count: int) -> ActionLog:
    log = ActionLog((), (), 5.0)
    for number in range(1, count + 1):
        log.ticket(Ticket(float(number), number, number, 100.0 + number, 99.0, ""), is_reference=True)
    return log


def test_a_ticket_taken_back_while_loads_are_measured_again_is_not_gone_on_with_after_a_kill() -> None:
    """A posting that names a ticket that is gone does not stand, nor what it says of the loads of other tickets."""
    log = weighed(3)
    assert log.take_waiting(1) == ((1, 2, 3), 1)
    log.undo_ticket(1, "somebody", 6.0)
    assert log.unfinished == (2, 3)
    log.posted((1, 2, 3), 1, {2: 1.1, 3: 1.2})
    assert (log.unfinished, log.ledger.factors) == ((), {})


def test_tickets_of_which_nothing_came_are_taken_again_with_the_next() -> None:
    log = weighed(2)
    assert log.take_waiting(1) == ((1, 2), 1)
    log.undo_ticket(2, "somebody", 6.0)
    log.ticket(Ticket(7.0, 3, 3, 103.0, 99.0, ""), is_reference=True)
    assert log.take_waiting(1) == ((1, 3), 1)
    assert (log.waiting, log.unfinished) == ([], (1, 3))


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
    log.take_waiting(1)
    log.posted((1,), 1, {1: 1.1, 2: 1.2, 3: 1.3})
    assert log.ledger.factors == {1: 1.1, 2: 1.2, 3: 1.3}, "a correction from before it began is known to it"
    log.wait_again([1], "")
    log.take_waiting(1)
    log.add(LOAD_NAMES, "somebody", corrected | {"before": [{"load": 2, "field": "", "crop": "corn"}]})
    log.add(LOAD_NAMES, "somebody", {"field": "south", "crop": None, "before": [{"load": 3, "field": "", "crop": "corn"}]})
    log.posted_by_crop({2: 0.9}, 6.0)
    log.posted((1,), 1, {1: 1.15, 2: 1.25, 3: 1.35})
    assert log.ledger.factors == {1: 1.15, 2: 0.9, 3: 1.35}
    log.wait_again([1], "")
    log.take_waiting(1)
    log.add(LOAD_NAMES, "somebody", corrected | {"before": [{"load": 3, "field": "", "crop": "corn"}]})
    count = sum(action.kind == POSTING for action in log)
    log.posted((1,), 1, {3: 1.4})
    assert sum(action.kind == POSTING for action in log) == count, "a posting of no load is none"
