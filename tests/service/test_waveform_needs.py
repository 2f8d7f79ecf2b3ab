"""What check-config says of a sensor that the waveform cannot use."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from yieldmon.cli.main import main
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.config.waveform_needs import notes


def configured(
    *,
    response_s: float,
    rate_hz: float = 1000.0,
    filter_s: float = 0.0,
    sensors: int = 1,
    weight_g: float = 350.0,
    enabled: bool = True,
) -> list[str]:
    known = configuration.load(shipped("config/yieldmon.yaml"))
    machine = replace(known.machine, sensor=replace(known.machine.sensor, response_s=response_s))
    waveform = replace(known.engine.waveform, enabled=enabled, thousand_kernel_weight_g=weight_g)
    sources = known.signals.sources
    impact = (replace(sources.impact[0], interval_s=1.0 / rate_hz, time_constant_s=filter_s),) * sensors
    inputs = tuple(source for source in sources.inputs if source.quantity != "thousand_kernel_weight")
    signals = replace(known.signals, sources=replace(sources, impact=impact, inputs=inputs))
    return notes(replace(known, machine=machine, engine=replace(known.engine, waveform=waveform), signals=signals))


SAID = {
    "slow cell": ({"response_s": 0.008}, ["behind a cell of 8 ms", "nothing is left of it", "answers within 0.3 ms"]),
    "cell too slow by little": ({"response_s": 0.003}, ["behind a cell of 3 ms", "8 kg/s for a minute", "and 25 % is the limit"]),
    "slow samples": ({"response_s": 0.0002, "rate_hz": 100.0}, ["100 samples per second", "needs 256", "mean force alone"]),
    "no band": (
        {"response_s": 0.0002, "rate_hz": 400.0},
        ["400 samples per second show nothing above 160 Hz", "begins at 200 Hz"],
    ),
    "no weight": ({"response_s": 0.0002, "weight_g": 0.0}, ["thousand_kernel_weights_g", "--thousand-kernel-weight"]),
    "no lag stated": ({"response_s": 0.0}, ["sensor.response_s", "--taps"]),
    "filter": ({"response_s": 0.0002, "filter_s": 0.02}, ["filter of 20 ms"]),
    "two sensors": ({"response_s": 0.0002, "sensors": 2}, ["2 impact sensors"]),
}


@pytest.mark.parametrize("case", SAID)
def test_what_is_missing_is_said_in_one_sentence(case: str) -> None:
    given, parts = SAID[case]
    (said,) = configured(**given)  # type: ignore[arg-type]
    for part in parts:
        assert part in said


@pytest.mark.parametrize("given", [{"response_s": 0.0002}, {"response_s": 0.001}, {"response_s": 0.008, "enabled": False}])
def test_nothing_is_said_of_a_sensor_that_can_do_it_or_of_a_waveform_that_is_off(given: dict[str, float]) -> None:
    assert configured(**given) == []  # type: ignore[arg-type]


def test_check_config_prints_it_and_the_configuration_stays_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "y.yaml"
    file.write_text("waveform: {enabled: true}\n", encoding="utf-8")
    assert main(["check-config", str(file)]) == 0
    assert "note: waveform.enabled: kernel noise will give no flow: behind a cell of 8 ms" in capsys.readouterr().out
