"""Mistakes that people make: one line that tells how to mend it, the right exit status, and every file as it was."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.cli import file_mistakes, more_mistakes
from tests.extras import hide
from yieldmon.cli.main import main
from yieldmon.files import parameter_file

STORE = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"
HEAD = "plate_angle_deg,mass_flow_kg_s,force_n\n"
TABLE = HEAD + "".join(f"{a},{m},{4.0 * m * (1.0 + 0.01 * (a - 70))}\n" for a in (45, 60, 70, 85) for m in (3, 8, 14, 20))
FILES = {
    "table.csv": TABLE,
    "radians.csv": HEAD + "0.8,10,40\n1.2,10,50\n",
    "empty.csv": "",
    "header.csv": HEAD,
    "text.csv": HEAD + "70,ten,40\n",
    "gap.csv": TABLE + "70,,40\n70,5,\n",
    "two.csv": "plate_angle_deg,mass_flow_kg_s,force_n,response\n70,1,2,3\n",
    "twice.csv": "plate_angle_deg,mass_flow_kg_s,force_n,FORCE_N\n70,1,2,3\n",
    "ragged.csv": HEAD + "70,1,5,2,5\n",
    "negative.csv": HEAD + "70,-1,2\n",
    "steep.csv": HEAD + "700,1,2\n",
    "percent.csv": HEAD.strip() + ",moisture_pct\n70,1,2,150\n",
    "sigma.csv": HEAD.strip() + ",sigma\n70,1,2,0\n60,1,2,1\n",
    "tickets.csv": "load,weighed_kg\n1,1000\n",
    "p.yaml": "friction: 0.2\ndensity: 1100\nshape_ratio: 2\nrestitution: 0.6\n",
    "bad-p.yaml": "friction: two\ndensity: 1100\nshape_ratio: 2\nrestitution: 0.6\n",
    "odd-p.yaml": "friktion: 0.2\n",
    "both-p.yaml": "friction: 0.2\ndensity: 1100\nshape_ratio: 2\nrestitution: 0.6\nk1: 1\nk2: 1\n",
    "high-p.yaml": "friction: 0.2\ndensity: 1100\nshape_ratio: 2\nrestitution: 1.6\n",
    "channel.yaml": "bus: {channel: 0}\n",
    "key.yaml": "swep: {}\n",
    "blank.yaml": "",
    "broken.yaml": "bus: [\n",
    "seconds.yaml": "zero: {settle_windows: 0.5}\n",
    "order.yaml": "gate: {grain_on_n: 1, grain_off_n: 5}\n",
    "diary.txt": "rain\n",
    "scenario.yaml": "duration_s: 5\n",
    "wrong-scenario.yaml": "duration_s: -5\n",
    "log.log": "(1.0) can0 123#00\n",
    "picture.png": "my picture\n",
}
MISTAKES = {
    # calibrate
    "no data": ("calibrate", "DATA: is missing"),
    "no such table": ("calibrate nowhere.csv", "nowhere.csv: No such file"),
    "an empty table": ("calibrate empty.csv", "empty.csv: is empty; expected a header line and rows"),
    "a header alone": ("calibrate header.csv", "has a header and no rows"),
    "a word for a number": ("calibrate text.csv", "text.csv: line 2, mass_flow_kg_s: is 'ten'; expected a number in kg/s"),
    "decimal commas between commas": ("calibrate ragged.csv", "line 2: has 5 fields; expected 3, as in the header (decimal"),
    "two readings": ("calibrate two.csv", "has ['force_n', 'response']; expected exactly one"),
    "a column twice": ("calibrate twice.csv", "has force_n more than once"),
    "a negative flow": ("calibrate negative.csv", "is -1; expected 0 to 1000 kg/s"),
    "700 degrees": ("calibrate steep.csv", "is 700; expected 0 to 180 deg"),
    "radians": ("calibrate radians.csv", "has nothing above 1.2; expected degrees; these look like radians"),
    "150 % moisture": ("calibrate percent.csv", "is 150; expected 0 to 100 %"),
    "a sigma of 0": ("calibrate sigma.csv", "column sigma has gaps or zeros"),
    "out over the data": ("calibrate table.csv --out table.csv", "--out table.csv: is also an input file"),
    "out over the data, by force": ("calibrate table.csv --out table.csv --force", "is also an input file"),
    "out over a file": ("calibrate table.csv --out p.yaml", "--out p.yaml: exists already; expected another name, or --force"),
    "out over the prior": ("calibrate table.csv --prior p.yaml --out p.yaml --force", "is also an input file"),
    "out in no folder": ("calibrate table.csv --out nowhere/p.yaml", "there is no folder"),
    "all fixed": (
        "calibrate table.csv --fix friction=0.2 --fix density=1100 --fix restitution=0.5",
        "--fix: leaves nothing to fit",
    ),
    "a parameter that is none": ("calibrate table.csv --fix colour=1", "--fix: colour is not a parameter"),
    "no value to fix": ("calibrate table.csv --fix friction", "--fix: is 'friction'; expected NAME=VALUE"),
    "friction of 9": ("calibrate table.csv --fix friction=9", "--fix friction: is 9; expected 0 to"),
    "bounds the wrong way": ("calibrate table.csv --bounds friction=1:0", "--bounds friction: is 1:0; expected the lower end"),
    "bounds that are none": ("calibrate table.csv --bounds friction=1", "expected NAME=LOW:HIGH"),
    "no starts": ("calibrate table.csv --starts 0", "--starts: is 0; expected a whole number from 1"),
    "an effect that is none": ("calibrate table.csv --effects magic", "--effects:"),
    "an angle that is not there": ("calibrate table.csv --plate-angle 33", "--plate-angle: is 33; expected an angle that"),
    "a scale for newtons": ("calibrate table.csv --response-scale 2", "expected a table of `response`"),
    "a prior that is none": ("calibrate table.csv --prior diary.txt", "diary.txt"),
    "a prior with a word": ("calibrate table.csv --prior bad-p.yaml", "bad-p.yaml: friction: is 'two'"),
    "a misspelt key": ("calibrate table.csv --prior odd-p.yaml", "friktion: unknown key"),
    "both forms": ("calibrate table.csv --prior both-p.yaml", "either restitution, or k1 and k2"),
    "restitution above 1": ("calibrate table.csv --prior high-p.yaml", "restitution: is 1.6"),
    "loads without tickets": ("calibrate --loads log.log", "--tickets: is missing"),
    "loads from a diary": ("calibrate --loads diary.txt --tickets tickets.csv", "diary.txt"),
    "loads from no store": ("calibrate --loads other.db --tickets tickets.csv", "other.db"),
    # predict, estimate, self-calibrate
    "predict a word": ("predict --mass-flow ten", "--mass-flow: is 'ten'; expected a finite number"),
    "predict backwards": ("predict --mass-flow 9:2:1", "expected a number, or first:last:step"),
    "predict a negative flow": ("predict --mass-flow -3", "--mass-flow: is -3"),
    "predict a flat plate": ("predict --mass-flow 3 --plate-angle 0", "--plate-angle: is 0"),
    "predict at no speed": ("predict --mass-flow 3 --elevator-speed 0", "--elevator-speed: is 0"),
    "predict with no such file": ("predict --mass-flow 3 --params nowhere.yaml", "nowhere.yaml"),
    "set nothing": ("predict --mass-flow 3 --set friction", "--set: is 'friction'; expected NAME=VALUE"),
    "estimate nothing": ("estimate nowhere.csv", "nowhere.csv: No such file"),
    "estimate with noise below 0": ("estimate table.csv --sigma -1", "--sigma: is -1"),
    "self-calibrate over its data": ("self-calibrate table.csv --out table.csv", "is also an input file"),
    "group by nothing": ("self-calibrate table.csv --group-by tractor", "--group-by: tractor is not a column"),
    # configuration
    "a channel without quotes": ("check-config channel.yaml", "bus.channel: 0; expected a word (a number in quotes)"),
    "a misspelt section": ("check-config key.yaml", "swep: unknown key; expected sweep"),
    "a blank configuration": ("check-config blank.yaml", "is empty; expected keys and values"),
    "broken YAML": ("check-config broken.yaml", "broken.yaml"),
    "half a window": ("check-config seconds.yaml", "zero.settle_windows: 0.5; expected a whole number"),
    "thresholds the wrong way": ("check-config order.yaml", "gate.grain_off_n: 5; expected at most gate.grain_on_n"),
    "no such configuration": ("check-config nowhere.yaml", "nowhere.yaml"),
    # logs
    "process nothing of ours": ("process log.log --out x.csv", "none of 1 frames is one that yieldmon takes in"),
    "process twice": ("process log.log ./log.log --out x.csv", "./log.log: is named twice, which would double its mass"),
    "process over the log": ("process log.log --out log.log --format csv", "is also an input file"),
    "process over a table": ("process log.log --out table.csv", "--out table.csv: exists already"),
    "process into a picture": ("process log.log --out x.png", "unknown kind of table '.png'"),
    "process with no processes": ("process log.log --out x.csv --jobs 0", "--jobs: is 0"),
    "record over the log": ("monitor log.log --once --record log.log", "--record log.log: is also an input file"),
    "record over a file": ("monitor log.log --once --record diary.txt", "--record diary.txt: exists already"),
    "watch backwards": ("monitor log.log --once --speed -1", "--speed: is -1"),
    "simulate over a log": ("simulate --scenario scenario.yaml --log log.log", "--log log.log: exists already"),
    "truth over the scenario": (
        "simulate --scenario scenario.yaml --log n.log --truth scenario.yaml --force",
        "is also an input file",
    ),
    "simulate no scenario": ("simulate --scenario moon --log n.log", "'moon' is neither a file nor shipped"),
    "demo of no scenario": ("demo --scenario moon", "'moon' is neither a file nor shipped"),
    "a negative duration": ("simulate --scenario wrong-scenario.yaml --log n.log", "duration_s: is -5"),
    "simulate to a diary": ("simulate --scenario scenario.yaml --log n.txt2", "n.txt2"),
    # pictures and exports
    "plot over a picture": ("plot curves --out picture.png", "--out picture.png: exists already"),
    "plot to a table": ("plot curves --out x.csv", "x.csv"),
    "plot no store": ("plot parameters other.db --out x.png", "other.db"),
    "plot a diary": ("plot flow diary.txt --out x.png", "unknown kind of record '.txt'"),
    "export over a file": ("export other.db --out table.csv", "--out table.csv: exists already"),
    "demo over a picture": ("demo --duration 5 --picture picture.png", "--picture picture.png: exists already"),
    # daemon's verbs, without a daemon
    "a ticket in pounds of tea": ("ticket 1 9120stone", "mass: '9120stone'; expected kilograms above 0"),
    "a ticket of nothing": ("ticket 1 0", "expected kilograms above 0"),
    "a ticket for a field": ("ticket north 9120", "LOAD: 'north'; expected a number such as 7"),
}


def fill(folder: Path) -> None:
    (folder / "folder").mkdir()
    shutil.copy(STORE, folder / "day.sqlite")
    for name, content in (FILES | more_mistakes.FILES | file_mistakes.FILES).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with sqlite3.connect(folder / "other.db") as database:
        database.execute("CREATE TABLE cows (name TEXT)")
    database.close()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of one's own, in which a command may write."""
    fill(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("mistakes")
    fill(folder)
    before = hashes(folder)
    yield folder
    assert hashes(folder) == before


@pytest.fixture
def untouched(filled: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In a folder that all these tests share, each of which fails where a file has been written, made or removed."""
    monkeypatch.chdir(filled)
    monkeypatch.setenv("COLUMNS", "200")
    before = stamps(filled)
    yield
    assert stamps(filled) == before


def hashes(folder: Path) -> dict[str, str]:
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


def stamps(folder: Path) -> dict[str, tuple[int, ...]]:
    """What changes with any writing: file number, size, times of the last change of content and of anything."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            seen = os.stat(path := os.path.join(place, name))
            found[path] = (seen.st_ino, seen.st_size, seen.st_mtime_ns, seen.st_ctime_ns)
    return found


ROWS = [(name, *row) for name, row in MISTAKES.items()]
ROWS += [(words, words, reported) for words, reported in (more_mistakes.MISTAKES | file_mistakes.MISTAKES).items()]


@pytest.mark.parametrize(("words", "reported"), [row[1:] for row in ROWS], ids=[row[0] for row in ROWS])
@pytest.mark.usefixtures("untouched")
def test_a_mistake_costs_a_line_and_no_file(capsys: pytest.CaptureFixture[str], words: str, reported: str) -> None:
    assert main(words.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert reported in err
    assert err.startswith("yieldmon: ")


@pytest.mark.parametrize("words", more_mistakes.USAGE)
@pytest.mark.usefixtures("untouched")
def test_words_that_do_not_fit_are_one_line_that_names_the_help(capsys: pytest.CaptureFixture[str], words: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    out, err = capsys.readouterr()
    assert (caught.value.code, out) == (2, "")
    assert err.startswith("yieldmon")
    assert err.endswith(" --help`)\n")
    assert err.count("\n") == 1


def test_rows_without_a_reading_are_counted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "gap.csv", "--starts", "2", "--json"]) == 0
    assert "gap.csv: 2 rows without a load or a reading are left out (lines 18, 19)" in capsys.readouterr().err


def test_a_prior_keeps_its_effects(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "table.csv", "--starts", "2", "--out", "first.yaml", "--effects", "gravity"]) == 0
    assert parameter_file.load("first.yaml").values["gravity.acceleration_m_s2"] == 9.81
    assert main(["calibrate", "table.csv", "--starts", "2", "--prior", "first.yaml", "--out", "second.yaml"]) == 0
    assert parameter_file.load("second.yaml").effects == ("gravity",)
    assert parameter_file.load("second.yaml").values["gravity.acceleration_m_s2"] == 9.81


def test_what_predict_writes_estimate_reads(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for params in ([], ["--params", "p.yaml"]):
        assert main(["predict", "--mass-flow", "5", "19", *params]) == 0
        Path("predicted.csv").write_text(capsys.readouterr().out)
        assert main(["estimate", "predicted.csv", *params]) == 0
        _flows_are_back(capsys.readouterr().out)


def _flows_are_back(written: str) -> None:
    flows = [float(line.split(",")[1]) for line in written.splitlines()[1:]]
    assert flows == pytest.approx([5.0, 19.0], rel=1e-6)


def test_a_plate_that_stands_still_needs_no_sweep_angles(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from yieldmon.resources import shipped

    machine = shipped("config/machines/sprocket-8.yaml").read_text().replace("min_plate_angle_deg: 40", "min_plate_angle_deg: 65")
    Path("m.yaml").write_text(machine)
    Path("still.yaml").write_text("machine_file: m.yaml\nsweep: {enabled: false}\n")
    assert main(["check-config", "still.yaml"]) == 0


def test_a_fit_that_is_not_determined_is_written_as_uncertain_as_its_bounds(folder: Path) -> None:
    Path("same.csv").write_text(HEAD + "70,10,70\n" * 6)
    assert main(["calibrate", "same.csv", "--starts", "3", "--bounds", "friction=0:0.6", "--out", "wide.yaml"]) == 0
    known = parameter_file.load("wide.yaml")
    # Six equal rows fix one direction of three: in the others the spread is that of a uniform distribution, about the value that
    # the search happened to end at where that is close to a bound.
    value, width = known.values["friction"], 0.6
    about = (((width - value) ** 3 + value**3) / (3.0 * width)) ** 0.5
    assert 0.3 * width / 12.0**0.5 < known.standard_deviation("friction") <= about * (1.0 + 1e-9)


WITHOUT = {
    "asammdf": (
        "mf4",
        "simulate --scenario scenario.yaml --log new.mf4",
        "monitor log.log --once --record new.mf4",
        "process bytes.mf4 --out x.csv",
        "process bytes.mf4 --out x.csv --jobs 1",
        "process bytes.mf4 --out tables --separate",
        "signals bytes.mf4",
    ),
    "pyarrow": (
        "parquet",
        "pack log.log --out new.parquet",
        "process bytes.parquet --out x.csv",
        "process log.log --out new.parquet",
    ),
}


@pytest.mark.parametrize(
    ("package", "extra", "words"), [(package, extra, words) for package, (extra, *lines) in WITHOUT.items() for words in lines]
)
def test_a_file_without_its_package_names_the_extra(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], package: str, extra: str, words: str
) -> None:
    hide(monkeypatch, package)
    Path("bytes.mf4").write_bytes(b"MDF     4.10")
    Path("bytes.parquet").write_bytes(b"PAR1")
    before = hashes(folder)
    assert main(words.split()) == 1
    assert capfd.readouterr() == ("", f"yieldmon: needs {package}, which is not installed; pip install 'yieldmon[{extra}]'\n")
    assert hashes(folder) == before


#: Ctrl-C ends the command also where the tests run in the background, which ignore it.
INTERRUPTIBLE = ("env", "--default-signal=INT")


INTERRUPTED = {
    "simulate": (
        "simulate --scenario demo --duration 9000 --log new.log",
        ".new.unfinished-*/new.log",
        r"yieldmon: interrupted; new.log holds \d+ s\n",
    ),
    "process": ("process long.log --out x.csv --jobs 1", "", "yieldmon: interrupted; x.csv is not written\n"),
}


@pytest.mark.parametrize(("words", "seen", "said"), INTERRUPTED.values(), ids=INTERRUPTED)
def test_ctrl_c_says_what_is_kept(folder: Path, words: str, seen: str, said: str) -> None:
    if not seen:
        # A log that is still being written: its reader waits for more, as one of a day is busy when it is interrupted.
        os.mkfifo("long.log")
    command = [*INTERRUPTIBLE, sys.executable, "-m", "yieldmon", *words.split()]
    pipe = subprocess.PIPE
    with (
        subprocess.Popen(
            command,
            stderr=pipe,
            stdout=pipe,
            text=True,
        ) as process,
        ExitStack() as held,
    ):
        if not seen:
            held.enter_context(Path("long.log").open("w"))
        while seen and not list(Path().glob(seen)):
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out) == (130, "")
    assert re.fullmatch(said, err)
    assert not Path("x.csv").exists()
    assert Path("new.log").exists() == bool(seen)
    assert not list(Path().glob(".*.unfinished-*"))
