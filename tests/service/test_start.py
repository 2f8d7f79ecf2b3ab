"""What the verbs that are called often import: the rest costs more than they do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.extras import MF4
from yieldmon.bus.log_files import log_writing, logs

TABLE = Path(__file__).resolve().parents[1] / "data" / "bench_table.csv"
HEAVY = {
    "asammdf", "can", "cantools", "matplotlib", "numpy", "pandas", "pyarrow", "pydantic", "rich", "scipy", "sqlite3", "yaml",
    "yieldmon.engine.monitor", "yieldmon.engine.records", "yieldmon.estimation.fitting.calibration",
    "yieldmon.estimation.self_calibration.closed_loop", "yieldmon.estimation.weighing.loads", "yieldmon.service.control_socket",
    "yieldmon.service.storage.store",
    *(PARTS_OF_SCIPY := {"scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats"}),
}  # fmt: skip


def imported(*arguments: str) -> set[str]:
    """Packages and modules among the heavy ones that a run of the command imports."""
    return loaded("from yieldmon.cli.main import main\ntry:\n    main()\nexcept SystemExit:\n    pass\n", *arguments)


def loaded(statements: str, *arguments: str) -> set[str]:
    """The same of a program."""
    program = (
        f"import sys\n{statements}"
        "names = [name for name, module in sys.modules.items() if module]\n"
        "print(*{*names, *(name.partition('.')[0] for name in names)}, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    return set(done.stderr.splitlines()[-1].split()) & HEAVY


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "empty.log"
    path.write_text("(1.0) can0 18FF10A0#0000000000000000\n", encoding="ascii")
    return path


@pytest.mark.parametrize(
    ("line", "allowed"),
    [
        ("--help", set()),
        ("status --socket /nonexistent", {"rich"}),
        ("load list --socket /nonexistent", {"rich"}),
        ("ticket list --socket /nonexistent", {"rich"}),
        ("calibrations list --socket /nonexistent", {"rich"}),
        ("zero --socket /nonexistent", set()),
        ("check-config", {"numpy", "pydantic", "yaml"}),
        ("monitor LOG --once --speed 0", {"can", "cantools", "rich", "sqlite3"}),
        ("calibrate --help", {"numpy"}),
        (
            "calibrate TABLE --starts 1",
            {"numpy", "scipy", "scipy.linalg", "scipy.special", "yaml", "yieldmon.estimation.fitting.calibration"},
        ),
        ("estimate --help", {"numpy", "yaml"}),
        ("simulate --help", {"can", "cantools", "numpy", "pydantic", "scipy", "sqlite3", "yaml"}),
        ("diagnose --help", HEAVY - PARTS_OF_SCIPY - {"pandas", "pyarrow", "matplotlib", "asammdf"}),
        ("demo --help", HEAVY - PARTS_OF_SCIPY - {"pandas", "pyarrow", "matplotlib", "asammdf"}),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_no_more_than_it_needs(line: str, allowed: set[str], log: Path) -> None:
    assert imported(*line.replace("LOG", str(log)).replace("TABLE", str(TABLE)).split()) <= allowed


def test_of_scipy_the_python_interface_has_what_is_called() -> None:
    assert loaded("from yieldmon import api\n") & PARTS_OF_SCIPY == set()


@MF4[0]
@MF4[1]
def test_mf4_logs_work_although_their_reader_waits(tmp_path: Path) -> None:
    """Written and read by a process in which the import was held back."""
    program = f"""
import sys
from yieldmon.bus.log_files import mf4
mf4.defer()
import can
assert "asammdf" not in sys.modules
from {log_writing.__name__} import writing
from {logs.__name__} import read_log
path = sys.argv[1]
with writing(path) as listener:
    listener(can.Message(timestamp=1.0, arbitration_id=0x18FF10A0, data=[1, 2, 3]))
assert [bytes(message.data) for message in read_log(path)] == [bytes([1, 2, 3])]
"""
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path / "x.mf4")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_a_daemon_calls_of_scipy_while_it_measures_is_imported_before() -> None:
    """An import at the end of a sweep would keep the engine's thread; a curve's is done when its file is read."""
    program = """
import re, sys
from pathlib import Path
import yieldmon.service.daemon
from yieldmon.service.preloading import preload

own = [module for name, module in sys.modules.items() if name.startswith("yieldmon.") and module.__file__]
texts = {module.__name__: Path(module.__file__).read_text(encoding="utf-8") for module in own}
called = {"scipy." + part for name, text in texts.items() if name != "yieldmon.estimation.flow_curve"
          for part in re.findall(r"\\bscipy\\.([a-z]+)|from scipy import ([a-z]+)", text) for part in part if part}
preload()
print(len(called), *sorted(called - sys.modules.keys()))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2"]
