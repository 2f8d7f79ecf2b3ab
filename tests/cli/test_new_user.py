"""Mistakes of a first evening with a store: set-up, tickets, reprocessing. One line each, and every file as it was."""

from __future__ import annotations

import gzip
import hashlib
import shutil
from pathlib import Path

import pytest

from yieldmon.cli._typed_mass import mass
from yieldmon.cli.main import main

STORE = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"
"""Two loads."""
FRAME = "(1.0) can0 123#00\n"
FILES = {
    "twice.csv": "load,weighed_kg\n1,5000\n1,5100\n",
    "ninety.csv": "load,weighed_kg\n99,5000\n",
    "both.csv": "load,weighed_kg,weighed_t\n1,5000,5\n",
    "german.csv": "load;weighed_kg\n1;5.000,5\n",
    "nothing.csv": "load,weighed_kg\n1,0\n",
    "header.csv": "load,weighed_kg\n",
    "tonnes.csv": "load,weighed_t\n1,5000\n",
    "wide.csv": "load,weighed_kg,std_dev_kg\n1,5000,9000\n",
    "good.csv": "load,weighed_kg\n1,5000\n",
    "mm.yaml": "machine_name: x\npaddle_length_m: 160\n",
    "list.yaml": "- 1\n- 2\n",
    "typo.yaml": "machine_nam: x\n",
    "a.log": FRAME,
}
CALIBRATE = "calibrate --loads s.sqlite --tickets"
NOBODY = "--socket nobody.sock"
MISTAKES = {
    f"{CALIBRATE} twice.csv": "twice.csv: line 3, load: load 1 has a ticket already (line 2); expected one row for each load",
    f"{CALIBRATE} ninety.csv": "is 99, no load that was measured; expected 1 to 2",
    f"{CALIBRATE} both.csv": "has weighed_kg and weighed_t; expected one column",
    f"{CALIBRATE} german.csv": "line 2, weighed_kg: is '5.000,5'; expected a number",
    f"{CALIBRATE} nothing.csv": "line 2, weighed_kg: is 0 kg; expected a mass from 1 to",
    f"{CALIBRATE} header.csv": "has a header and no rows",
    f"{CALIBRATE} tonnes.csv": "line 2, weighed_t: is 5e+06 kg; expected a mass from 1 to",
    f"{CALIBRATE} wide.csv": "std_dev_kg: is 9000 kg; expected above 0 and below the load's 5000 kg",
    f"{CALIBRATE} s.sqlite": "is a database, as a daemon's store is; expected a table; of a store: `calibrate --loads STORE`",
    "self-calibrate s.sqlite": "is a database, as a daemon's store is; expected a table; of a store:",
    f"{CALIBRATE} good.csv --out s.sqlite --force": "is also an input file",
    f"{CALIBRATE} good.csv --free friction": "--free: applies to a table of a test facility only",
    "calibrate --loads s.sqlite": "--tickets: is missing",
    "calibrate --tickets good.csv": "DATA: is missing; expected a table of a test facility, or --loads",
    "calibrate --loads folder.sqlite --tickets good.csv": "folder.sqlite: is a folder; expected a daemon's store",
    "calibrate --loads s.sqlite a.log --tickets good.csv": "names s.sqlite together with other sources; expected one store, or",
    "setup --answers mm.yaml --out new": "mm.yaml: paddle_length_m: is 160; expected 0.02 to 1 m",
    "setup --answers list.yaml --out new": "is not a mapping of answers; expected keys such as",
    "setup --answers typo.yaml --out new": "typo.yaml: machine_nam: is not asked; expected machine_name\n",
    "setup --answers nowhere.yaml --out new": "nowhere.yaml: No such file",
    "setup --answers mm.yaml --out good.csv": "--out: good.csv is not a folder",
    "process a.log a.log.gz --out x.csv": "a.log.gz: is the same log as a.log, one of them gzipped, and would double its mass",
    "process s.sqlite --out s.sqlite --zero-mv 1": "is also an input file",
    "process s.sqlite --out x.csv": "is a store, measured already; expected --params, --estimator,",
    "process s.sqlite --out x.csv --zero-mv -3": "--zero-mv: is -3; expected 0 to 100000 mV",
    "process s.sqlite a.log --out x.csv": "names a store together with other sources; expected one store alone",
    f"ticket 7 {NOBODY}": "MASS: is missing; expected the weighed mass",
    f"ticket 7 9,12t {NOBODY}": "mass: '9,12t'; expected kilograms above 0, such as 9120, 9120kg, 9.12t or 20106lb, with a point",
    f"ticket 7 9 stone {NOBODY}": "mass: '9 stone'; expected kilograms",
    f"ticket 7 9t --std-dev 3% {NOBODY}": "--std-dev: '3%'; expected kilograms",
    f"ticket 7..9 9t {NOBODY}": "LOAD: '7..9'; expected a number such as 7, or FIRST-LAST",
    f"ticket 9-7 9t {NOBODY}": "expected the first load before the last",
    f"ticket undo {NOBODY}": "ticket undo: no number; expected the number of a ticket",
    f"ticket list 3 {NOBODY}": "'3' has no meaning here",
    "map s.sqlite --out good.csv": "--out: good.csv is a file; expected a folder",
    "plot flow s.sqlite --out s.sqlite --force": "is also an input file",
    "predict --mass-flow 5 --moisture 150": "--moisture: is 150; expected 0 to 100 %",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(FRAME.encode()))
    (tmp_path / "folder.sqlite").mkdir()
    shutil.copy(STORE, tmp_path / "s.sqlite")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("words", "reported"), MISTAKES.items(), ids=list(MISTAKES))
def test_a_mistake_costs_a_line_and_no_file(folder: Path, capsys: pytest.CaptureFixture[str], words: str, reported: str) -> None:
    before = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir() if path.is_file()}
    assert main(words.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1), err
    assert err.startswith("yieldmon: ")
    assert reported in err
    assert {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir() if p.is_file()} == before


@pytest.mark.parametrize(
    "written",
    [
        "9120", "9 120 kg", "9\u202f120 kg", "9\u00a0120\u00a0kg", "9,120kg", "9'120 kg", "9\u2019120 kg", "9120 kilos",
        "9.12 t", "9.120t", "9.12 metric tons", "9.12 MT", "91.2 dt", "91.2 q", "91.2 quintals", "20,106.16 pounds",
    ],
)  # fmt: skip
def test_a_mass_is_read_as_slips_have_it(written: str) -> None:
    assert mass(written) == pytest.approx(9120.0, rel=1e-6)


def test_a_blank_between_mass_and_unit_is_no_mistake(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["ticket", "7", "9.12", "t", *NOBODY.split()])
    assert caught.value.code == 1
    assert (
        capsys.readouterr().err
        == "yieldmon: nobody.sock: no daemon answers there; is the service running? (`systemctl status yieldmon`)\n"
    )
