"""Two commands that write one file: neither replaces the other's unasked."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from yieldmon.cli import pack
from yieldmon.cli.main import main
from yieldmon.files.unfinished import make_folder
from yieldmon.service.logs import recorded

STORE = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"


@pytest.mark.parametrize(
    ("command", "module", "reads"),
    [(f"export {STORE} --out o.csv", recorded, "read_seconds"), ("pack a.log --out o.parquet", pack, "pack_logs")],
    ids=["export", "pack"],
)
def test_two_commands_with_one_output_lose_nothing(command, module, reads, tmp_path, monkeypatch, capsys):
    """The second finds the first's file when its own is done, which may be hours after it looked."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.log").write_text("(1.0) can0 18FF10A0#0000000000000000\n", encoding="ascii")
    out = Path(command.split()[-1])

    def slow(*arguments):
        found = work(*arguments)
        out.write_text("of the first", encoding="utf-8")
        return found

    work = getattr(module, reads)
    monkeypatch.setattr(module, reads, slow)
    assert main(command.split()) == 2
    kept = out.with_stem("o-2")
    assert f"{out}: another program made it meanwhile; what was to be written is {kept}" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == "of the first"
    assert kept.stat().st_size > 500


@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("signals a.log --write -", "--write"),
        ("pack a.log --out -", "--out"),
        ("simulate --duration 1 --log b.log --truth -", "--truth"),
        (f"export {STORE} --out -", "--out"),
    ],
)
def test_a_dash_is_no_files_name(command, option, tmp_path, monkeypatch, capsys):
    """A file of that name was made where standard output was meant."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.log").write_text("(1.0) can0 18FF10A0#0000000000000000\n", encoding="ascii")
    assert main(command.split()) == 2
    assert f"{option}: is -; expected a file's name" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


def test_what_a_killed_command_left_goes_with_the_next(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.log").write_text("(1.0) can0 18FF10A0#0000000000000000\n", encoding="ascii")
    left = make_folder(tmp_path / "o.yaml")
    os.utime(left, (1.0, 1.0))
    assert main(["signals", "a.log", "--write", "o.yaml"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.log", "o.yaml"]


def test_what_a_killed_command_left_in_a_folder_goes_with_the_next(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--duration", "3", "--log", "a.log"]) == 0
    (tmp_path / "out").mkdir()
    left = make_folder(tmp_path / "out" / "a.csv")
    os.utime(left, (1.0, 1.0))
    assert main(["process", "a.log", "--separate", "--out", "out"]) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.csv"]
