"""What the cab's keys ask a daemon for, each with a question before it is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from yieldmon.errors import InputError
from yieldmon.units import Units

Request = dict[str, Any]
KEYS = "lxtzw"
"""That begin a question."""
NO_DAEMON = "no daemon answers on this computer: these keys need one"
_TICKET = "ticket: number of the load and its weighed mass, such as 7 9.12t: "
_UNDER_WAY = ("moving", "settling", "measuring", "returning")
_ESCAPE, _ENTER, _BACK = "\x1b", ("\r", "\n"), ("\x7f", "\b")


@dataclass(slots=True)
class Dialog:
    """The question that stands, what is typed, and the requests that a yes sends.

    Parameters
    ----------
    mass_kg : callable
        Reads a mass as people type it; InputError where it is none.
    crop_of : callable
        The name of the known crop that what people type means; None where it means none.
    known_crops : callable () -> sequence of str
        Names of these.
    question : str
        That stands, or what became of a request.
    typed : str or None
        So far, of an answer that ends with Enter; None where none is asked for.
    """

    mass_kg: Callable[[str], float]
    crop_of: Callable[[str], str | None]
    known_crops: Callable[[], Sequence[str]]
    question: str = ""
    typed: str | None = None
    _on_yes: Sequence[Request] = ()
    _on_enter: Callable[[str, Units], None] | None = None
    _choices: dict[str, Callable[[], None]] = field(default_factory=dict)

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

    def press(self, key: str, status: Mapping[str, Any] | None, units: Units) -> Sequence[Request]:
        """Apply a key; returns the requests to send, in order. status: of the daemon, None where none answers."""
        if self._on_yes:
            requests, self._on_yes, self.question = self._on_yes, (), ""
            if key.lower() == "y":
                return requests
            self.question = "nothing was done"
        elif self.typed is not None:
            self._type(key, units)
        elif self._choices:
            self._choose(key)
        else:
            self._begin(key, status, units)
        return ()

    def _begin(self, key: str, status: Mapping[str, Any] | None, units: Units) -> None:
        if key not in KEYS:
            return
        if status is None:
            self.question = NO_DAEMON
            return
        load = status["load"]
        if key == "l":
            held = f"load {load['number']} holds {units.mass(load['mass_kg'])}"
            again = f", {load['crop']} again" if load["crop"] else ""
            fresh = f"{held}: start load {load['number'] + 1}{again}? y n"
            self._choices = {"n": partial(self._ask, fresh, {"command": "load-start"})}
            stop = ""
            if load["open"]:
                self._choices["s"] = partial(self._ask, f"{held}: is it complete? y n", {"command": "load-stop"})
                stop = "s: it is complete, "
            self.question = f"{held}; n: a new load, {stop}Esc: neither"
        elif key == "x":
            self._choices = {"n": partial(self._other_crop, load), "c": partial(self._wrong_load, status)}
            self.question = "n: a new load of another crop, c: correct the crop of a load, Esc: neither"
        elif key == "t":
            self._read(_TICKET, self._ticket)
        elif key == "z":
            self._ask("take the zero: does the elevator run empty? y n", {"command": "zero"})
        elif status["sweep"]["state"] not in _UNDER_WAY:
            self._ask("sweep the plate as soon as the flow is steady? y n", {"command": "sweep-start"})
        else:
            self._ask("end the sweep and take the plate home? y n", {"command": "sweep-abort"})

    def _ask(self, question: str, *requests: Request) -> None:
        self.question, self._on_yes = question, requests

    def _read(self, question: str, then: Callable[[str, Units], None]) -> None:
        self.question, self.typed, self._on_enter = question, "", then

    def _choose(self, key: str) -> None:
        chosen, self._choices = self._choices.get(key.lower()), {}
        if chosen is None:
            self.question = "nothing was done"
        else:
            chosen()

    def _type(self, key: str, units: Units) -> None:
        typed, then = self.typed or "", self._on_enter
        if key == _ESCAPE:
            self.typed, self.question = None, "nothing was done"
        elif key in _BACK:
            self.typed = typed[:-1]
        elif key in _ENTER and then is not None:
            self.typed = None
            try:
                then(typed.strip(), units)
            except InputError as error:
                self.question = str(error)
        elif key.isprintable():
            self.typed = typed + key

    def _ticket(self, typed: str, units: Units) -> None:
        number, _, text = typed.partition(" ")
        if not number.isdecimal():
            raise InputError("ticket", f"{typed!r}", "a load's number, a blank and a mass, such as 7 9.12t")
        mass_kg = self.mass_kg(text.strip())
        request = {"command": "ticket", "first_load": int(number), "mass_kg": mass_kg}
        self._ask(f"load {number} weighed {units.mass(mass_kg)}: right? y n", request)

    def _other_crop(self, load: Mapping[str, Any]) -> None:
        def named(typed: str, units: Units) -> None:
            crop, known = self._crop(typed)
            held = f"load {load['number']} holds {units.mass(load['mass_kg'])}"
            self._ask(f"{held}: start load {load['number'] + 1} of {crop}{known}? y n", {"command": "load-start", "crop": crop})

        self._read(f"crop of the new load ({self._known}): ", named)

    def _wrong_load(self, status: Mapping[str, Any]) -> None:
        load = status["load"]
        newest = int(load["number"])
        # Those of the status hold grain, or are open.
        complete = [one["number"] for one in status["loads"] if one["number"] != newest or not load["open"]]
        usual = complete[-1] if complete else newest

        def numbered(typed: str, _units: Units) -> None:
            number = typed or str(usual)
            if not number.isdecimal() or not 0 < int(number) <= newest:
                raise InputError("load", repr(typed), f"a number from 1 to {newest}")
            self._read(f"crop of load {number} ({self._known}): ", partial(self._correct, int(number), load))

        self._read(f"number of the load whose crop is wrong (Enter: {usual}): ", numbered)

    def _correct(self, number: int, load: Mapping[str, Any], typed: str, units: Units) -> None:
        crop, known = self._crop(typed)
        correct = {"command": "load-correct", "first_load": number, "last_load": number, "crop": crop}
        if load["open"] and number == load["number"]:
            # Only a complete load takes another crop: grain of the right one goes on in a new load.
            held = f"load {number} is open and holds {units.mass(load['mass_kg'])}"
            start = {"command": "load-start", "crop": crop}
            self._ask(f"{held}: start load {number + 1} of {crop}, and make load {number} {crop} too{known}? y n", start, correct)
        else:
            self._ask(f"load {number} was {crop}{known}: right? y n", correct)

    def _crop(self, typed: str) -> tuple[str, str]:
        """The crop that a name means, and what is to be said of one that is not known. Raises InputError."""
        if not typed:
            raise InputError("crop", repr(typed), "the name of a crop")
        found = self.crop_of(typed)
        return (typed, " (not a crop that is known: it is only named)") if found is None else (found, "")

    @property
    def _known(self) -> str:
        return " ".join(self.known_crops())
