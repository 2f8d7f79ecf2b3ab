"""What `status` says of a load's standard deviation."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

from tests.service.bench import running
from yieldmon.cli import main as cli
from yieldmon.service.operator.control import ControlServer


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of a daemon that has begun."""
    folder = tmp_path_factory.mktemp("daemon")
    with running(folder) as bench:
        bench.play(14, 0.0)
        bench.played()
        with contextlib.redirect_stdout(io.StringIO()) as out:
            assert cli.main(["status", "--socket", str(folder / "yieldmon.sock"), "--json"]) == 0
    status: dict[str, Any] = json.loads(out.getvalue())
    return status


@pytest.mark.parametrize(
    ("spread_kg", "parameters_kg", "said"),
    [(87.0, 80.0, True), (87.0, 60.0, False), (19.0, 19.0, False), (None, 80.0, False), (87.0, None, False)],
    ids=["by the calibration", "by something else", "small", "not known", "parts not known"],
)
def test_a_load_that_the_calibration_leaves_unsure_is_told_what_helps(
    document: dict[str, Any],
    spread_kg: float | None,
    parameters_kg: float | None,
    said: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    causes = {"noise": 5.0, "parameters": parameters_kg, "zero": 5.0, "moisture": 5.0}
    load = {**document["load"], "mass_kg": 1000.0, "std_dev_kg": spread_kg, "std_dev_by_cause_kg": causes}
    server = ControlServer(tmp_path / "yieldmon.sock", None, lambda _: {**document, "load": load})
    server.start()
    try:
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
    finally:
        server.stop()
    assert ("weigh a load (`yieldmon ticket`) to reduce it" in " ".join(capsys.readouterr().out.split())) is said


@pytest.mark.parametrize(("spread_kg", "said"), [(87.0, "total 4,321 kg ± 87.0 kg"), (None, "total 4,321 kg")])
def test_the_total_is_shown_with_its_standard_deviation(
    document: dict[str, Any], spread_kg: float | None, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    total = {**document["total"], "mass_kg": 4321.0, "std_dev_kg": spread_kg}
    server = ControlServer(tmp_path / "yieldmon.sock", None, lambda _: {**document, "total": total})
    server.start()
    try:
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
    finally:
        server.stop()
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("total"))
    assert " ".join(row.split()) == said


NOT_CALIBRATED = "not calibrated on this machine: its force is known to 45 %"
OF_CORN = "a crop that was not weighed, with the scale of corn: its force is known to 12 %"


@pytest.mark.parametrize(
    ("scale_error", "other", "said"),
    [(0.45, "", {NOT_CALIBRATED}), (0.12, "corn", {OF_CORN}), (0.0, "", set())],
)
def test_parameters_of_no_calibration_are_said_to_be_that(
    document: dict[str, Any],
    scale_error: float,
    other: str,
    said: set[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert document["parameters"]["scale_error"] == 0.0, "the shipped corn on the shipped machine"
    parameters = {**document["parameters"], "scale_error": scale_error, "carried_from": other}
    server = ControlServer(tmp_path / "yieldmon.sock", None, lambda _: {**document, "parameters": parameters})
    server.start()
    try:
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
    finally:
        server.stop()
    shown = " ".join(capsys.readouterr().out.split())
    assert {sentence for sentence in (NOT_CALIBRATED, OF_CORN) if sentence in shown} == said


KERNELS = {
    "published": True, "shape_volume_flow_m3_s": None, "shape_volume_std_dev_m3_s": None, "shape_flow_kg_s": None,
    "shape_std_dev_kg_s": None, "shape_verdict": "no_pulses", "shape_missing_because": "no pulse", "kernel_flow_kg_s": 20.0,
    "kernel_std_dev_kg_s": 3.0, "kernel_verdict": "used", "kernel_missing_because": None, "thousand_kernel_weight_g": 700.0,
    "contradiction": None, "stretch_by_mean_force": None, "kernel_bias_by_mean_force": 0.6,
}  # fmt: skip


@pytest.mark.parametrize(
    ("told", "said"),
    [({"only_kernels_set_scale": True}, True), ({"only_kernels_set_scale": False}, False), ({}, False)],
    ids=["by kernels alone", "weighed", "a daemon that does not tell"],
)
def test_a_scale_that_rests_on_the_kernel_weight_alone_is_said_to(
    document: dict[str, Any], told: dict[str, bool], said: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server = ControlServer(tmp_path / "yieldmon.sock", None, lambda _: {**document, "waveform": {**KERNELS, **told}})
    server.start()
    try:
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
    finally:
        server.stop()
    text = " ".join(capsys.readouterr().out.split())
    assert "kernels 20.0 kg/s ± 3.00 kg/s" in text
    assert ("scale rests on 700 g for a thousand kernels: no weighed load confirms it" in text) is said
