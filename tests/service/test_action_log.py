"""What operators entered: which tickets still wait to be learnt from, or for their loads to be measured again."""

from __future__ import annotations

from yieldmon.service.action_log import ActionLog
from yieldmon.service.batch import Ticket


def test_tickets_that_update_wait_until_they_are_taken_or_taken_back() -> None:
    log = ActionLog((), (), 5.0)
    tickets = [Ticket(float(n), n, n, 100.0 + n, 99.0, "") for n in range(1, 4)]
    assert [log.ticket(ticket, is_reference=ticket.first_load != 2) for ticket in tickets] == [1, 2, 3]
    assert log.waiting == [1, 3]
    assert log.undo_ticket(3, "somebody", 6.0) == tickets[2]
    assert log.waiting == [1]
