"""What a user gets of the waveform: status, records, tables and the kernels' weight over loads, crops and restarts."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.bench import running
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory, recall
from yieldmon.service.operator import commands
from yieldmon.service.storage.store import Store

ON = """
bus: {transmit_max_age_s: 60}
waveform: {enabled: true, thousand_kernel_weights_g: {wheat: 42}, thousand_kernel_weight_g: 300}
"""


def started(tmp_path: Path, text: str = ON):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    known = configuration.load(path)
    return build_monitor(known.engine, known.machine, known.parameters, known.calibrator), Journal(
        Memory(), known.parameters, now_s=0.0
    )


def load_start(monitor, journal, **request):
    commands.execute({"command": "load-start", **request}, monitor, journal, 1.7e9)
    return monitor.kernel_weight_g


def test_the_kernel_weight_is_the_entered_one_then_the_crop_s_then_the_configured(tmp_path: Path) -> None:
    monitor, journal = started(tmp_path)
    assert load_start(monitor, journal) == 300.0
    assert load_start(monitor, journal, thousand_kernel_weight_g=352.0) == 352.0
    assert load_start(monitor, journal, field="north") == 352.0
    assert load_start(monitor, journal, crop="wheat") == 42.0
    assert load_start(monitor, journal, thousand_kernel_weight_g=45.5) == 45.5
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([journal.batch(monitor, 1.7e9, {})])
        memory = recall(store)
    after, _ = started(tmp_path)
    commands.set_crop(after, Journal(memory, after.estimator.parameters, now_s=0.0))
    assert after.kernel_weight_g == 45.5


def test_a_weight_where_nothing_looks_at_it_changes_nothing(tmp_path: Path) -> None:
    monitor, journal = started(tmp_path, "bus: {}")
    before = monitor.totals.load_number
    with pytest.raises(InputError, match=r"expected waveform\.enabled: true"):
        commands.execute({"command": "load-start", "thousand_kernel_weight_g": 300.0, "crop": "rye"}, monitor, journal, 1.7e9)
    assert (monitor.totals.load_number, journal.crop, journal.kernel_weight_g) == (before, "", None)


def test_status_and_records_say_what_there_is_and_why_the_rest_is_missing(tmp_path: Path) -> None:
    with running(tmp_path, ON) as bench:
        bench.play(16.0, 0.0)
        bench.play(10.0, 150.0)
        bench.played()
        seen, rows = bench.status["waveform"], bench.rows
    assert seen["kernel_verdict"] == "too_early"
    assert seen["shape_verdict"] in {verdict.name.lower() for verdict in ShapeVerdict}
    assert (seen["shape_verdict"] == "used") is (seen["shape_flow_kg_s"] is not None)
    assert seen["kernel_missing_because"]
    assert seen["only_kernels_set_scale"] is False
    assert (seen["shape_flow_kg_s"] is None) is bool(seen["shape_missing_because"])
    assert rows[-1]["mean_force_flow_kg_s"] > 0.0
    assert {"shape_volume_flow_m3_s", "shape_verdict", "kernel_verdict", "thousand_kernel_weight_g"} <= set(rows[-1])
    assert rows[-1]["thousand_kernel_weight_g"] == 300.0


def test_before_the_first_second_status_says_that_none_was_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running(tmp_path, ON) as bench:
        assert bench.status["waveform"]["kernel_verdict"] == "not_looked_at"
        assert main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
    rows = [
        line.split(maxsplit=1)[1].strip()
        for line in capsys.readouterr().out.splitlines()
        if line.startswith(("shape ", "kernels "))
    ]
    assert rows == ["no flow: no second has been measured yet"] * 2


@pytest.mark.parametrize(("weight_g", "said"), [("0.35", "0, or from 1 g"), ("350000", "0 to 2000 g"), ("-5", "0 to 2000 g")])
def test_a_weight_that_no_thousand_kernels_have_is_refused(tmp_path: Path, weight_g: str, said: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(f"waveform: {{enabled: true, thousand_kernel_weight_g: {weight_g}}}\n")
    with pytest.raises(InputError) as found:
        configuration.load(path)
    assert "waveform.thousand_kernel_weight_g" in str(found.value)
    assert said in str(found.value)
    monitor, journal = started(tmp_path)
    with pytest.raises(InputError, match="thousand_kernel_weight_g"):
        load_start(monitor, journal, thousand_kernel_weight_g=float(weight_g))
    assert monitor.kernel_weight_g == 300.0
