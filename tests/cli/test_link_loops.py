"""A link that leads back to itself, where a verb reads and where it writes: one line, exit status 2, and the link stays."""

from __future__ import annotations

import pytest

from tests.cli.test_mistakes import TABLE
from yieldmon.cli.main import main

READ = "Too many levels of symbolic links"
WRITTEN = "is a link that leads back to itself; expected the name of a file to write"
COMMANDS = {
    "process loop.log --out o.csv": READ,
    "process log.log --out loop.csv": WRITTEN,
    "signals loop.log": READ,
    "pack loop.log --out x.parquet": READ,
    "replay loop.log -i virtual -c x": READ,
    "calibrate loop.csv --out p.yaml": READ,
    "calibrate table.csv --out loop.csv": WRITTEN,
    "estimate table.csv --params loop.csv": READ,
    "diagnose loop.csv --adopt p.yaml": READ,
    "diagnose table.csv --adopt loop.csv": WRITTEN,
    "check-config loop.csv": READ,
    "setup --answers loop.csv --out folder": READ,
    "map loop.csv --out folder": "loop.csv",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_link_in_a_circle_is_one_line(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.csv").write_text(TABLE, encoding="utf-8")
    (tmp_path / "log.log").write_text("(1.0) can0 123#00\n", encoding="utf-8")
    for name in ("loop.log", "loop.csv"):
        (tmp_path / name).symlink_to(name)
    assert main(command.split()) == 2
    lines = capsys.readouterr().err.splitlines()
    assert COMMANDS[command] in lines[-1]
    assert lines[-1].startswith("yieldmon: ")
    assert (tmp_path / "loop.csv").is_symlink()
    assert not (tmp_path / "o.csv").exists()
