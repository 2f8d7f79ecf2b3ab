"""What the cab's keys ask a daemon for, each with a question before it is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from yieldmon.errors import InputError
from yieldmon.units import Units

Request = dict[str, Any]
NO_DAEMON = "no daemon answers on this computer: these keys need one"
_TICKET = "ticket: number of the load and its weighed mass, such as 7 9.12t: "
_UNDER_WAY = ("moving", "settling", "measuring", "returning")
_ESCAPE, _ENTER, _BACK = "\x1b", ("\r", "\n"), ("\x7f", "\b")


@dataclass(slots=True)
class Dialog:
    """The question that stands, what is typed, and the request that a yes sends.

    Parameters
    ----------
    mass_kg : callable
        Reads a mass as people type it; InputError where it is none.
    """

    mass_kg: Callable[[str], float]
    question: str = ""
    typed: str | None = None
    _on_yes: Request = field(default_factory=dict)
    _choices: dict[str, tuple[str, Request]] = field(default_factory=dict)

    @property
    def open(self) -> bool:
        """Whether a question stands, which takes all keys."""
        return bool(self._on_yes or self._choices or self.typed is not None)

    @property
    def prompt(self) -> str:
        """What to show."""
        return self.question + (f"{self.typed}_" if self.typed is not None else "")

    def report(self, text: str) -> None:
        """Show what became of a request, unless a question stands."""
        if not self.open:
            self.question = text

    def press(self, key: str, status: Mapping[str, Any] | None, units: Units) -> Request | None:
        """Apply a key; returns the request to send. status: of the daemon, None where none answers."""
        if self._on_yes:
            request, self._on_yes, self.question = self._on_yes, {}, ""
            if key.lower() == "y":
                return request
            self.question = "nothing was done"
        elif self.typed is not None:
            self._type(key, units)
        elif self._choices:
            self._choose(key)
        else:
            self._begin(key, status, units)
        return None

    def _begin(self, key: str, status: Mapping[str, Any] | None, units: Units) -> None:
        if key not in "ltzw":
            return
        if status is None:
            self.question = NO_DAEMON
            return
        load = status["load"]
        if key == "l":
            held = f"load {load['number']} holds {units.mass(load['mass_kg'])}"
            fresh = f"{held}: start load {load['number'] + 1}? y n"
            self._choices = {"n": (fresh, {"command": "load-start"})}
            stop = ""
            if load["open"]:
                self._choices["s"] = (f"{held}: is it complete? y n", {"command": "load-stop"})
                stop = "s: it is complete, "
            self.question = f"{held}; n: a new load, {stop}Esc: neither"
        elif key == "t":
            self.question, self.typed = _TICKET, ""
        elif key == "z":
            self._ask("take the zero: does the elevator run empty? y n", {"command": "zero"})
        elif status["sweep"]["state"] not in _UNDER_WAY:
            self._ask("sweep the plate as soon as the flow is steady? y n", {"command": "sweep-start"})
        else:
            self._ask("end the sweep and take the plate home? y n", {"command": "sweep-abort"})

    def _ask(self, question: str, request: Request) -> None:
        self.question, self._on_yes = question, request

    def _choose(self, key: str) -> None:
        chosen, self._choices = self._choices.get(key.lower()), {}
        if chosen is None:
            self.question = "nothing was done"
        else:
            self._ask(*chosen)

    def _type(self, key: str, units: Units) -> None:
        typed = self.typed or ""
        if key == _ESCAPE:
            self.typed, self.question = None, "nothing was done"
        elif key in _BACK:
            self.typed = typed[:-1]
        elif key in _ENTER:
            self.typed = None
            self._ticket(typed, units)
        elif key.isprintable():
            self.typed = typed + key

    def _ticket(self, typed: str, units: Units) -> None:
        number, _, text = typed.strip().partition(" ")
        try:
            if not number.isdecimal():
                raise InputError("ticket", f"{typed!r}", "a load's number, a blank and a mass, such as 7 9.12t")
            mass_kg = self.mass_kg(text.strip())
        except InputError as error:
            self.question = str(error)
            return
        request = {"command": "ticket", "first_load": int(number), "mass_kg": mass_kg}
        self._ask(f"load {number} weighed {units.mass(mass_kg)}: right? y n", request)
