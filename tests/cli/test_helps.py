"""The help of every verb and of every word below it, as a terminal of 80 columns shows it."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tools.reference.commands import parsers
from yieldmon.cli.main import build_parser, find_verbs


@pytest.fixture(scope="module")
def helps() -> dict[str, str]:
    """By verb and word."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        return {name: parser.format_help() for name, parser in parsers()}


def test_every_verb_is_there(helps: dict[str, str]) -> None:
    assert {name.partition(" ")[0] for name in helps} == set(find_verbs())
    assert {"load start", "fleet prior", "plot parameters", "totals reset", "calibrations undo"} <= set(helps)


def test_each_line_fits_a_terminal(helps: dict[str, str]) -> None:
    assert [(name, line) for name, text in helps.items() for line in text.splitlines() if len(line) > 80] == []


def test_no_percent_sign_is_doubled(helps: dict[str, str]) -> None:
    assert [name for name, text in helps.items() if "%%" in text] == []


def test_each_has_an_example_that_is_a_command(helps: dict[str, str]) -> None:
    verbs = find_verbs()
    for name, text in helps.items():
        found = [part for part in text.split("\n\n") if part.startswith("example: ")]
        assert len(found) == 1, name
        whole = found[0].removeprefix("example: ").rstrip().replace("\\\n", " ")
        assert whole.startswith(f"yieldmon {name}"), name
        for command in whole.replace("&&", "\n").partition(", then ")[0].splitlines():
            program, *words = shlex.split(command)
            assert program == "yieldmon", name
            build_parser(verbs, verbs[words[0]])[0].parse_args(words)


def test_a_file_is_named_FILE_and_a_number_N(helps: dict[str, str]) -> None:
    others = {"F", "FILENAME", "PARAMS", "SEED", "COUNT"}
    assert {name: found for name, text in helps.items() if (found := others & set(text.replace("]", " ").split()))} == {}


@pytest.mark.parametrize("words", ["--version", "--help", "process --help"])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_help_that_cannot_be_written_is_no_success(words: str, unbuffered: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "yieldmon", *words.split()],
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith("yieldmon: No space left on device")
    assert len(done.stderr.splitlines()) == 1
