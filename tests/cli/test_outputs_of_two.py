"""Two commands that write one file: neither replaces the other's unasked."""

from __future__ import annotations

from pathlib import Path

from yieldmon.cli import pack
from yieldmon.cli.main import main
from yieldmon.service import recorded

STORE = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"


def test_two_commands_with_one_output_lose_nothing(tmp_path, monkeypatch, capsys):
    """The second finds the first's table when its own is done, which may be hours after it looked."""
    out = tmp_path / "o.csv"

    def slow(*arguments):
        found = read_seconds(*arguments)
        out.write_text("of the first", encoding="utf-8")
        return found

    read_seconds = recorded.read_seconds
    monkeypatch.setattr(recorded, "read_seconds", slow)
    assert main(["export", str(STORE), "--out", str(out)]) == 2
    assert "o.csv: another program made it meanwhile; what was to be written is o-2.csv" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == "of the first"
    assert (tmp_path / "o-2.csv").stat().st_size > 1000


def test_pack_keeps_what_another_program_made_meanwhile(tmp_path, monkeypatch, capsys):
    log, out = tmp_path / "a.log", tmp_path / "a.parquet"
    log.write_text("(1.0) can0 18FF10A0#0000000000000000\n", encoding="ascii")

    def slow(*arguments):
        packed = packing(*arguments)
        out.write_text("of the first", encoding="utf-8")
        return packed

    packing = pack.pack
    monkeypatch.setattr(pack, "pack", slow)
    assert main(["pack", str(log), "--out", str(out)]) == 2
    assert "a.parquet: another program made it meanwhile; what was to be written is a-2.parquet" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == "of the first"
    assert (tmp_path / "a-2.parquet").is_file()
