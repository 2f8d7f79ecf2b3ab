"""Which tickets of a table are those of one machine's day."""

from __future__ import annotations

from collections.abc import Sequence

from yieldmon.errors import InputError
from yieldmon.files.ticket_file import WeighedTicket


def own_tickets(
    tickets: Sequence[WeighedTicket], machine: str, sharing: Sequence[tuple[str, str]]
) -> tuple[list[WeighedTicket], list[InputError]]:
    """The tickets that are a machine's, and what is wrong with others.

    Parameters
    ----------
    tickets : sequence of WeighedTicket
        Of one table.
    machine : str
        The day's.
    sharing : sequence of (str, str)
        Machine and day of all partitions that have this table, if several do; else empty.

    Returns
    -------
    list of WeighedTicket
        Without those whose `machine` is another one that has the table.
    list of InputError
        Tickets of a machine that does not have the table, and numbers that mean a log in each of several days.
    """
    machines = {machine, *(name for name, _ in sharing)}
    own, refused = list[WeighedTicket](), list[InputError]()
    for ticket in tickets:
        days = [name for name, _ in sharing if ticket.machine in ("", name)]
        if ticket.machine and ticket.machine not in machines:
            refused.append(InputError(ticket.where, f"is of the machine {ticket.machine!r}", " or ".join(sorted(machines))))
        elif ticket.machine and ticket.machine != machine:
            continue
        elif len(days) > 1 and ticket.first.isdecimal():
            problem = f"load {ticket.name} is one in each of the {len(days)} days that this table is for"
            refused.append(InputError(ticket.where, problem, "the name of its log, or a table for each day"))
        else:
            own.append(ticket)
    return own, refused
