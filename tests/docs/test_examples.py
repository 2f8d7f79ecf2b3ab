"""Every program of examples/ runs and prints what it is about; the public interface is what it says."""

from __future__ import annotations

import ast
import json
import os
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from yieldmon import api
from yieldmon.cli.main import main

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PROGRAMS = sorted(path.stem for path in EXAMPLES.glob("*.py"))
#: What each prints, as a pattern.
PRINTED = {
    "calibrate_table": r"restitution +0\.5\d+ \+- ",
    "decode_frames": r"ElevatorSpeed: ElevatorSpeed 39\d",
    "drive_engine": r"39\.1 s +1\d\.\d\d kg/s",
    "forward_model": r"10\.0 kg/s +90\.1 N",
    "invert_force": r"60\.0 N +6\.\d\d kg/s, standard deviation 0\.\d*[1-9]",
    "invert_log": r"\d+ frames, [78] seconds, 0 with a flow",
    "own_study": r"0\.20 +-?0\.0 +-?0\.0 +-?0\.0\n",
    "plot_store": r"179 seconds in ",
    "self_calibrate": r"friction before 0\.\d+, after 0\.\d+, true",
}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "combine.log"
    assert main(["simulate", "--duration", "8", "--log", str(path)]) == 0
    return path


@pytest.mark.parametrize("name", PROGRAMS)
def test_it_runs(
    name: str, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = {
        "decode_frames": [str(log)],
        "invert_log": [str(log)],
        "plot_store": [str(ROOT / "tests/golden/store-0.1.0.sqlite"), str(tmp_path / "flow.png")],
    }
    monkeypatch.setattr(sys, "argv", [name, *arguments.get(name, [])])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert re.search(PRINTED[name], capsys.readouterr().out)


def imports(path: Path) -> set[str]:
    """Modules of the package that a program imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {f"{node.module}.{alias.name}" for alias in node.names} if node.module == "yieldmon" else {node.module}
    return {name for name in found if name.partition(".")[0] == "yieldmon"}


@pytest.mark.parametrize("path", sorted(EXAMPLES.rglob("*.py")), ids=lambda path: path.name)
def test_it_uses_the_public_interface_only(path: Path) -> None:
    assert imports(path) == {"yieldmon.api"}


def test_each_is_in_the_list() -> None:
    listed = set(re.findall(r"`(\w+)\.py`", (EXAMPLES / "README.md").read_text(encoding="utf-8")))
    assert listed == set(PROGRAMS)


@pytest.mark.parametrize("name", api.__all__)
def test_public_names_are_there_and_documented(name: str) -> None:
    value = getattr(api, name)
    assert value is not None
    if callable(value):
        assert value.__doc__


def installed(folder: Path, entry_points: str) -> dict[str, str]:
    """Environment variables of a process that finds the plug-in as pip would have installed it in `folder`."""
    info = folder / "damp_plate-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: damp-plate\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[yieldmon.effects]\n{entry_points}\n", encoding="utf-8")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(EXAMPLES / "effect_plugin"), str(ROOT)])}


def predict(environment: dict[str, str], *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "yieldmon", "predict", "--mass-flow", "10", "--plate-angle", "70", "--json", *options]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_an_effect_from_outside_the_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = tomllib.loads((EXAMPLES / "effect_plugin" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ((name, value),) = project["entry-points"]["yieldmon.effects"].items()
    environment = installed(tmp_path, f"{name} = {value}")
    damp = predict(environment, "--set", "damp_plate.loss=0.1")
    assert damp.stderr == ""
    capsys.readouterr()
    assert main(["predict", "--mass-flow", "10", "--plate-angle", "70", "--json"]) == 0
    force_n = [json.loads(text)["rows"][0]["force_n"] for text in (capsys.readouterr().out, damp.stdout)]
    assert force_n[1] == pytest.approx(0.9 * force_n[0], rel=1e-6)


@pytest.mark.parametrize(
    ("entry", "wrong"),
    [("x = nowhere:EFFECT", "cannot be loaded"), ("x = json:dumps", "is a function"),
     ("x = yieldmon.physics.effects.gravity:EFFECT", "gravity exists already")],
    ids=["missing", "no effect", "name taken"],
)  # fmt: skip
def test_a_plug_in_that_is_none_is_named(entry: str, wrong: str, tmp_path: Path) -> None:
    program = (
        "from yieldmon.errors import InputError\nfrom yieldmon.physics.effects import registry\n"
        "try:\n    registry()\nexcept InputError as error:\n    print(error)"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=installed(tmp_path, entry), capture_output=True, text=True, check=True)
    assert done.stdout.startswith("effect plug-in x (")
    assert wrong in done.stdout
