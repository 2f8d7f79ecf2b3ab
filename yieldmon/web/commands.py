"""What a page may ask of the daemon. The daemon's own guards decide; here is only what a page may send at all."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from yieldmon.errors import InputError
from yieldmon.web.units import SENTENCES

#: Command -> the arguments that it takes from a page. `zero --force` and `totals reset` are left to the command line.
ALLOWED: Mapping[str, frozenset[str]] = {
    "load-start": frozenset({"field", "crop"}),
    "load-stop": frozenset(),
    "load-correct": frozenset({"first_load", "last_load", "field", "crop"}),
    "ticket": frozenset({"first_load", "last_load", "mass_kg", "std_dev_kg", "other_kg", "other_std_dev_kg", "note"}),
    "ticket-undo": frozenset({"ticket"}),
    "zero": frozenset(),
    "zero-undo": frozenset(),
    "sweep-start": frozenset(),
    "sweep-abort": frozenset(),
}
#: Commands that a page shows with a load's number, which it sends along: it may have changed since.
_ABOUT_A_LOAD = frozenset({"load-start", "load-stop"})

#: What a refusal says of the command line -> the page's button.
_BUTTONS: Mapping[str, str] = {
    "(--other)": "(field Other combine)",
    "`yieldmon zero --force`": "`yieldmon zero --force` on the monitor's computer",
    "`yieldmon load start`": "New load",
    "`yieldmon load stop`": "End load",
    "`yieldmon load correct`": "Wrong crop",
    "`yieldmon zero --undo`": "Undo zero",
    "`yieldmon zero`": "Zero",
    "zero --undo:": "Undo zero:",
    "load stop:": "End load:",
    "load-start:": "New load:",
    "load-stop:": "End load:",
}

_UNDO_TICKET = re.compile(r"`yieldmon ticket undo ([0-9]+)`")


def with_buttons(refusal: str) -> str:
    """A refusal of the daemon in the words of the page, which has buttons where the command line has verbs.

    >>> with_buttons("load stop: no load is open; expected one that `yieldmon load start` began")
    'End load: no load is open; expected one that New load began'
    """
    for words, button in _BUTTONS.items():
        refusal = refusal.replace(words, button)
    return _UNDO_TICKET.sub(r"Undo ticket \1", refusal)


def answer_with_buttons(answer: Any) -> Any:
    """A daemon's answer with its sentences in the words of the page, as `with_buttons`.

    >>> answer_with_buttons({"question": "or ticket 1 is wrong (`yieldmon ticket undo 1`)", "ticket": 2})
    {'question': 'or ticket 1 is wrong (Undo ticket 1)', 'ticket': 2}
    """
    if isinstance(answer, Mapping):
        return {
            name: with_buttons(value) if name in SENTENCES and isinstance(value, str) else answer_with_buttons(value)
            for name, value in answer.items()
        }
    return [answer_with_buttons(value) for value in answer] if isinstance(answer, list) else answer


def request_of(document: object, load_number: int | None) -> dict[str, Any]:
    """The daemon's request from a page's.

    Parameters
    ----------
    document : object
        What the page sent: ``command``, its arguments, and ``shown_load`` for commands about the load in the tank.
    load_number : int or None
        The load's number now, None where it is not known.

    Returns
    -------
    dict
        Fit for `yieldmon.service.operator.control_client.ask`.

    Raises
    ------
    InputError
        For another command or argument, or a load that is not the one shown.
    """
    if not isinstance(document, dict) or not isinstance(document.get("command"), str):
        raise InputError("request", "names no command", "a JSON object with a command")
    command = document["command"]
    if command not in ALLOWED:
        raise InputError("command", repr(command)[:100], f"one of {', '.join(ALLOWED)}")
    arguments = {name: value for name, value in document.items() if name not in ("command", "shown_load")}
    strange = sorted(set(arguments) - ALLOWED[command])
    if strange:
        raise InputError(command, f"takes no {strange[0][:40]!r}", ", ".join(sorted(ALLOWED[command])) or "no argument")
    if command in _ABOUT_A_LOAD and document.get("shown_load") != load_number:
        if load_number is None:
            raise InputError(command, "the number of the load is not known", "the command again, once it is")
        raise InputError(
            command, f"the load in the tank is now {load_number}", "Cancel, a look at that load, and then the button again"
        )
    return {"command": command, **arguments}
