"""Answers as they come: from a file, from the terminal, and kept after each so that a set-up can go on later."""

from __future__ import annotations

import difflib
import shutil
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import can

from yieldmon.cli._setup.questions import QUESTIONS, Question
from yieldmon.cli._setup.written_numbers import OTHER_UNITS, in_decimals, numbers
from yieldmon.errors import InputError, brief
from yieldmon.files import strict_yaml, whole_file
from yieldmon.files.crops import crop

KEPT = "setup-answers.yaml"
_SHOWN = 40


def from_file(path: str | Path) -> dict[str, Any]:
    """The answers in a YAML file. Raises InputError for a key that is not asked or a value that does not fit."""
    content = strict_yaml.load(path)
    if not isinstance(content, Mapping):
        raise InputError(str(path), "is not a mapping of answers", f"keys such as {QUESTIONS[3].key}: 0.0541")
    known = {question.key: question for question in QUESTIONS}
    if isinstance(content.get("answers"), Mapping):
        raise InputError(str(path), "is the record of a set-up", f"its answers alone, as in {KEPT} in the same folder")
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            raise InputError(f"{path}: {key}", "is not asked", near[0] if near else f"one of {', '.join(known)}")
    return {key: checked(known[key], value, f"{path}: {key}") for key, value in content.items()}


def keep(answers: Mapping[str, Any], folder: Path) -> None:
    """Write the answers beside what will be made of them."""
    whole_file.write(folder / KEPT, strict_yaml.dump(dict(answers)))


def checked(question: Question, value: Any, where: str) -> Any:
    """The value as the set-up uses it. Raises InputError."""
    if question.kind == "word":
        text = str(value).strip()
        if not text or not text.isprintable() or isinstance(value, list | Mapping | None):
            raise InputError(where, f"is {value!r}", "a word")
        return interface(text, where) if question.key == "bus_interface" else crop(text).name if question.key == "crop" else text
    if question.kind == "number":
        return _number(question, value, where)
    values = [_number(question, v, where) for v in value] if isinstance(value, list) else _numbers(question, str(value), where)
    if not values:
        raise InputError(where, "is empty", f"numbers in {question.unit}")
    return values


def interface(name: str, where: str) -> str:
    """As python-can writes it. Raises InputError."""
    found = name.lower()
    if found not in can.VALID_INTERFACES:
        near = difflib.get_close_matches(found, can.VALID_INTERFACES, n=1, cutoff=0.5)
        raise InputError(where, f"is {name!r}", near[0] if near else f"one of {', '.join(sorted(can.VALID_INTERFACES))}")
    return found


def _number(question: Question, value: Any, where: str) -> float:
    found = _numbers(question, str(value), where) if not isinstance(value, bool) else []
    if len(found) != 1:
        raise InputError(where, f"is {value}", f"one number in {question.unit}")
    return found[0]


def _numbers(question: Question, text: str, where: str) -> list[float]:
    if decimal := in_decimals(text):
        raise InputError(where, f"is {brief(text.strip(), _SHOWN)}", f"decimal numbers of one unit: {brief(decimal, _SHOWN)}")
    units = ", ".join([question.unit, *OTHER_UNITS.get(question.unit, {})])
    try:
        found = numbers(text, question.unit)
    except (ValueError, KeyError) as error:
        wrong = brief(_typed(text, str(error.args[0]).split()[0]), _SHOWN)
        raise InputError(where, f"is {wrong}", f"{question.low:g} to {question.high:g} {question.unit} (or in {units})") from None
    for number in found:
        if not question.low <= number <= question.high:
            shown = text.strip() if len(found) == 1 else f"{number:g}"
            raise InputError(where, f"is {shown}", f"{question.low:g} to {question.high:g} {question.unit}")
    return found


def _typed(text: str, wrong: str) -> str:
    """The word of a text that is no number, whole."""
    return next((word for word in text.split() if wrong in word), wrong)


def wrapped(text: str) -> str:
    """For a terminal, without a word cut in two."""
    width = shutil.get_terminal_size().columns - 1
    return textwrap.fill(text, width, initial_indent="   ", subsequent_indent="   ", break_on_hyphens=False)


def ask(
    answers: dict[str, Any],
    read: Callable[[str], str],
    say: Callable[[str], None],
    kept: Callable[[Mapping[str, Any]], None],
    check: Callable[[Mapping[str, Any], str], None] = lambda answers, key: None,
) -> dict[str, Any]:
    """Ask for what is missing. `back` returns to the question before; answers are handed to `kept` after each.

    check: raises InputError for an answer, by its key, that does not go with those before it.
    """
    place = 0
    while place < len(QUESTIONS):
        question = QUESTIONS[place]
        if question.key in answers or not question.applies(answers):
            place += 1
            continue
        one = question.kind == "numbers" and question.words(answers) != question.text
        if question.drawing and not one:
            say(question.drawing)
        unit = f" [{question.unit}]" if question.unit else ""
        default = (
            f" ({question.default:g})"
            if isinstance(question.default, float)
            else f" ({question.default})"
            if question.default is not None
            else ""
        )
        several = ", several" if question.kind == "numbers" and not one else ""
        given = read(f"{place + 1}/{len(QUESTIONS)} {question.words(answers)}{unit}{several}{default}: ").strip()
        if given == "back":
            place = max(place - 1, 0)
            while place > 0 and not QUESTIONS[place].applies(answers):
                place -= 1
            answers.pop(QUESTIONS[place].key, None)
            continue
        value = given if given else question.default
        if value is None:
            say("   an answer is needed; `back` goes back, Ctrl-C keeps what is answered")
            continue
        try:
            answers[question.key] = checked(question, value, question.key)
            check(answers, question.key)
        except InputError as error:
            say(wrapped(str(error)))
            answers.pop(question.key, None)
            continue
        kept(answers)
        place += 1
    return answers
