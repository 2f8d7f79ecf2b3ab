"""Published schemas hold for what the commands print (run here, or kept outputs, held equal to real ones), and see spoilt
documents."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest

from tests.golden import kept
from tests.schema_check import SCHEMAS, problems
from tools.reference.commands import parsers
from tools.reference.documents import DOCUMENTS
from yieldmon.cli.main import main

KEPT = {
    "calibrate-dem": "calibrate", "calibrate-bench": "calibrate", "calibrate-corn": "calibrate", "diagnose-dem": "diagnose",
    "diagnose-bench": "diagnose", "demo": "demo", "self-calibrate": "self-calibrate",
}  # fmt: skip


#: Command, its exit code, and the schema of what it prints; {} is a folder with a log and tables.
RUNS = [
    ("predict --mass-flow 10", 0, "predict"),
    ("predict --mass-flow 2,9 --moisture 14 --plate-position 0.01 --params {}/without-covariance.yaml", 0, "predict"),
    ("estimate {}/forces.csv", 0, "estimate"),
    ("estimate {}/loads.csv", 0, "estimate"),
    ("check-config", 0, "check-config"),
    ("check-config --log {}/day.log", 0, "check-config"),
    ("check-config {}/wrong.yaml", 2, "check-config"),
    ("monitor {}/day.log --once --speed 0", 0, "monitor"),
    ("simulate --duration 1 --log {}/second.log", 0, "simulate"),
    ("replay {}/day.log -i virtual -c schemas --speed 1000 --to 1", 0, "replay"),
    ("replay {}/day.log -i virtual -c schemas --speed 0", 0, "replay"),
    ("pack {}/day.log --out {}/day.parquet", 0, "pack"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("schemas")
    (path / "forces.csv").write_text("plate_angle_deg,force_n\n70,60\n70,-\n")
    (path / "loads.csv").write_text("plate_angle_deg,force_n,mass_flow_kg_s\n70,60,9\n70,0,0\n")
    (path / "wrong.yaml").write_text("sweep: {interval_s: 5}\n")
    (path / "without-covariance.yaml").write_text("friction: 0.3\ndensity: 800\nshape_ratio: 2\nrestitution: 0.3\n")
    assert main(["simulate", "--duration", "3", "--log", str(path / "day.log")]) == 0
    return path


@pytest.mark.parametrize(("command", "code", "schema"), RUNS)
def test_what_is_printed_follows_its_schema(
    command: str, code: int, schema: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.format(folder, folder).split(), "--json"]) == code
    assert problems(json.loads(capsys.readouterr().out), schema) == []


@pytest.mark.parametrize(("case", "schema"), KEPT.items())
def test_kept_outputs_follow_their_schema(case: str, schema: str) -> None:
    assert problems(json.loads(kept.load(case)), schema) == []


def test_every_document_has_a_schema() -> None:
    assert {path.stem for path in SCHEMAS.glob("*.json")} == set(DOCUMENTS)
    printing = {name.replace(" ", "-") for name, parser in parsers() if "[--json]" in parser.format_usage()}
    assert len(printing) > 20
    assert printing <= set(DOCUMENTS)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [(lambda d: d.pop("verdict"), "document has no verdict"),
     (lambda d: d.update(verdict="perhaps"), "document.verdict is 'perhaps'"),
     (lambda d: d.update(more=1), "document has more"),
     (lambda d: d["gap"].update(noise_floor_rms="small"), "document.gap.noise_floor_rms is 'small'"),
     (lambda d: d["candidates"].append({}), "has no name"),
     (lambda d: d["notes"].append(True), "not string")],
)  # fmt: skip
def test_a_corrupt_document_is_detected(spoil, said: str) -> None:
    document = copy.deepcopy(json.loads(kept.load("diagnose-dem")))
    spoil(document)
    assert any(said in problem for problem in problems(document, "diagnose"))
