"""The commands whose outputs are kept, and the run of them in a process of its own.

A script without an import of the project's tests, so that it also runs with another checkout's package on PYTHONPATH:

    PYTHONPATH=/path/to/checkout python tests/golden/cases.py OUT_FOLDER [NAME ...]
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
DATA = TESTS / "data"
STORE = TESTS / "golden" / "store-0.1.0.sqlite"
PARAMETERS = TESTS / "golden" / "parameters-0.1.0.yaml"

_HARVEST = """\
duration_s: 400
crop: {moisture_pct: 18.0, end_moisture_pct: 16.0}
effects: {gravity: on, moisture_dependence: on}
flow:
  variation_pct: 3.0
  pieces:
    - {kind: steady, duration_s: 20, flow_kg_s: 0}
    - {kind: stop-and-go, duration_s: 1000, flow_kg_s: 12, flow_variation_pct: 25, pass_s: 60, headland_s: 15,
       unload_every: 3, unload_s: 40}
tank: {capacity_kg: 9000, unload_from_kg: 1000}
frames: {grain_condition: true, position: true, harvest_state: true}
"""


@dataclass(frozen=True)
class Case:
    """One golden output.

    Attributes
    ----------
    name : str
        Stem of the kept file.
    command : tuple of str
        Arguments of `yieldmon`; `{out}` is the scratch folder.
    reads : str
        File below the scratch folder that holds the output; empty: standard output.
    before : tuple of tuple of str
        Commands that make its inputs.
    """

    name: str
    command: tuple[str, ...]
    reads: str = ""
    before: tuple[tuple[str, ...], ...] = ()


def _log(scenario: str, duration_s: int, seed: int, name: str) -> tuple[str, ...]:
    return (
        *("simulate", "--scenario", scenario, "--duration", str(duration_s), "--seed", str(seed)),
        *("--log", f"{{out}}/{name}.log", "--truth", f"{{out}}/{name}-truth.csv", "--start-time", "1790000000"),
    )


_HARVEST_LOG = _log("{out}/harvest.yaml", 400, 4, "harvest")
_HARVEST_TABLE = ("process", "{out}/harvest.log", "--out", "{out}/harvest.csv", "--jobs", "1")
_MADE = (_HARVEST_LOG, _HARVEST_TABLE)
_DEM, _BENCH, _CORN = (str(DATA / name) for name in ("dem_table.csv", "bench_table.csv", "corn_facility.csv"))

CASES: tuple[Case, ...] = (
    Case(
        "predict",
        ("predict", "--mass-flow", "2:26:3", "--plate-angle", "40:90:10", "--elevator-speed", "300", "400", "500", "--json"),
    ),
    Case("estimate", ("estimate", _CORN, "--params", str(PARAMETERS), "--sigma", "1", "--json")),
    Case("calibrate-dem", ("calibrate", _DEM, "--plate-angle", "70", "--json")),
    Case("calibrate-bench", ("calibrate", _BENCH, "--impact", "exchange", "--effects", "plate_angle_offset", "--json")),
    Case("calibrate-corn", ("calibrate", _CORN, "--starts", "5", "--robust", "--json")),
    Case("self-calibrate", ("self-calibrate", _CORN, "--params", str(PARAMETERS), "--sigma", "1", "--json")),
    Case("diagnose-dem", ("diagnose", _DEM, "--json")),
    Case("diagnose-bench", ("diagnose", _BENCH, "--json")),
    Case("simulate-demo", _log("demo", 40, 5, "demo"), reads="demo.log"),
    Case("simulate-truth", _HARVEST_LOG, reads="harvest-truth.csv"),
    Case("process-harvest", _HARVEST_TABLE, reads="harvest.csv", before=(_HARVEST_LOG,)),
    Case(
        "process-sweep",
        ("process", "{out}/sweep.log", "--out", "{out}/sweep.jsonl", "--jobs", "1"),
        reads="sweep.jsonl",
        before=(_log("sweep", 90, 6, "sweep"),),
    ),
    Case("process-bench", ("process", str(DATA / "bench_log.log.gz"), "--out", "{out}/bench.csv"), reads="bench.csv"),
    Case("demo", ("demo", "--duration", "60", "--seed", "3", "--json")),
    Case("export-store", ("export", str(STORE), "--out", "{out}/store.csv"), reads="store.csv"),
    Case("export-loads", ("export", str(STORE), "--out", "{out}/loads.csv", "--what", "loads"), reads="loads.csv"),
    Case(
        "export-geojson",
        ("export", "{out}/harvest.csv", "--out", "{out}/harvest.geojson", "--swath", "9.1"),
        reads="harvest.geojson",
        before=_MADE,
    ),
    Case(
        "export-agleader",
        ("export", "{out}/harvest.csv", "--out", "{out}/harvest.txt", "--swath", "9.1"),
        reads="harvest.txt",
        before=_MADE,
    ),
    Case(
        "export-taskdata",
        ("export", "{out}/harvest.csv", "--out", "{out}/taskdata.zip", "--swath", "9.1"),
        reads="taskdata.zip",
        before=_MADE,
    ),
)


class Runner:
    """Runs cases in one scratch folder; an input that several need is made once.

    Parameters
    ----------
    folder : Path
        Scratch folder.
    main : callable
        The command line's entry: takes the arguments, returns the exit status.
    """

    def __init__(self, folder: Path, main: Callable[[list[str]], int]) -> None:
        self._folder = folder
        self._main = main
        self._made: set[tuple[str, ...]] = set()
        (folder / "harvest.yaml").write_text(_HARVEST)

    def output(self, case: Case) -> str:
        """The case's output as text. Raises RuntimeError when a command fails."""
        for command in case.before:
            self._run(command)
        if case.reads:
            self._run(case.command)
            return _text(self._folder / case.reads)
        return self._run(case.command)

    def _run(self, command: tuple[str, ...]) -> str:
        if command in self._made:
            return ""
        arguments = [part.format(out=self._folder) for part in command]
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = self._main(arguments)
        if status:
            raise RuntimeError(f"yieldmon {' '.join(arguments)}: exit {status}: {err.getvalue()}")
        self._made.add(command)
        return out.getvalue()


def _text(path: Path) -> str:
    if path.suffix != ".zip":
        return path.read_text()
    with zipfile.ZipFile(path) as archive:
        return "".join(f"{name}\n{archive.read(name).hex()}\n" for name in sorted(archive.namelist()))


def _entry(arguments: list[str]) -> int:
    from yieldmon.cli.main import main

    try:
        return main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    wanted = set(sys.argv[2:])
    runner = Runner(folder, _entry)
    texts = {case.name: runner.output(case) for case in CASES if not wanted or case.name in wanted}
    (folder / "outputs.json").write_text(json.dumps(texts))
