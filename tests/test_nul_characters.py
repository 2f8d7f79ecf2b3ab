"""A NUL character in a path or a word: one line names it, whatever takes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from yieldmon import api
from yieldmon.cli.main import find_verbs, main

NAME = "mine\0file"
READERS: dict[str, Callable[[], Any]] = {
    "configuration": lambda: api.load_configuration(f"{NAME}.yaml"),
    "machine": lambda: api.load_machine(f"{NAME}.yaml"),
    "parameters": lambda: api.load_parameters(f"{NAME}.yaml"),
    "parameters to save": lambda: api.save_parameters(api.load_parameters(), f"{NAME}.yaml"),
    "scenario": lambda: api.load_scenario(f"{NAME}.yaml"),
    "table": lambda: api.load_table(f"{NAME}.csv"),
    "workbook": lambda: api.load_table(f"{NAME}.xlsx"),
    "seconds": lambda: api.read_seconds(Path(f"{NAME}.csv")),
    "store": lambda: api.read_loads(f"{NAME}.sqlite"),
    "log": lambda: list(api.read_log(f"{NAME}.log")),
    "binary log": lambda: list(api.read_log(f"{NAME}.blf")),
    "database": lambda: api.Codec(f"{NAME}.dbc"),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_path_with_a_nul_is_named(kind: str) -> None:
    with pytest.raises(api.InputError, match=r"^mine\\x00file\.\w+: holds a NUL character; expected a name without one$"):
        READERS[kind]()


def test_a_database_of_a_mapping_with_a_nul_is_named(tmp_path: Path) -> None:
    path = tmp_path / "y.yaml"
    path.write_text('signals: {elevator_speed: {dbc: "mine\\0.dbc", message: A, signal: B}}\n')
    with pytest.raises(api.ConfigurationError, match=r"mine\\x00\.dbc: holds a NUL character"):
        api.load_configuration(path)


@pytest.mark.parametrize("verb", sorted(find_verbs()))
def test_a_word_of_a_command_with_a_nul_is_named(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, NAME]) == 2
    assert capsys.readouterr().err == "yieldmon: mine\\x00file: holds a NUL character; expected a name without one\n"
