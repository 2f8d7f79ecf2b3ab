"""The waveform beside the mean force, through the monitor, on the virtual combine's frames."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import can
import numpy as np
import pytest

from studies.waveform.frame_runs import run_of
from tests.service.bench import CODEC
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import WindowResult, records_in, windows_in
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.engine.state import EngineState
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import NOT_CALIBRATED, WEIGHED, ParameterSet
from yieldmon.estimation.waveform.channel_combination import combine
from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict
from yieldmon.files import pulse_shape_file
from yieldmon.frames import ELEVATOR_SPEED, GRAIN_KERNELS, Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.storage.rows import SecondRow

MACHINE = Machine()
VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
PARAMETERS = ParameterSet(VALUES, ("friction", "density", "restitution"), np.diag([0.02**2, 22.0**2, 0.08**2]))
FLOW_KG_S = 8.0
LAW = pulse_shape_file.load()


@cache
def traffic() -> tuple[Frame, ...]:
    pieces = [{"kind": "steady", "duration_s": 12, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 20, "flow_kg_s": FLOW_KG_S}]
    return tuple(VirtualCombine(from_mapping({"duration_s": 26, "flow": {"pieces": pieces}}, "test"), seed=5).frames_until(26.0))


def as_run(frames: Sequence[Frame], *, kernels: bool = True) -> FrameRun:
    """The same bits as frame by frame in a fifth of the time. kernels: with the frames that report their weight."""
    return run_of([frame for frame in frames if kernels or frame.message != GRAIN_KERNELS])


@cache
def harvested(**settings: object) -> tuple[WindowRecord, ...]:
    """Records of the last ten seconds."""
    waveform = replace(WaveformSettings(), shape=LAW, **settings)  # type: ignore[arg-type]
    return tuple(records_in(looking(waveform).feed_run(as_run(traffic()))))[-10:]


def looking(waveform: WaveformSettings) -> Monitor:
    """Of the shipped machine, without sweeps."""
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    return Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))


def test_a_run_of_frames_gives_the_bits_of_single_ones() -> None:
    monitor = looking(replace(WaveformSettings(), shape=LAW, enabled=True, combine=True, thousand_kernel_weight_g=350.0))
    single = [r for frame in traffic() for r in records_in(monitor.feed(frame))][-10:]
    assert all(r.shape_verdict is ShapeVerdict.USED for r in single)
    assert repr(tuple(single)) == repr(harvested(enabled=True, combine=True, thousand_kernel_weight_g=350.0))


def test_is_off_unless_asked_for_and_then_changes_nothing_else() -> None:
    plain, seen = harvested(), harvested(enabled=True)
    assert all(np.isnan(r.shape_flow_kg_s) and np.isnan(r.kernel_flow_kg_s) for r in plain)
    assert [(r.mass_flow_kg_s, r.mass_kg) for r in seen] == [(r.mass_flow_kg_s, r.mass_kg) for r in plain]


def test_shape_gives_the_flow_beside_the_mean_force() -> None:
    records = harvested(enabled=True)
    flows = np.array([r.shape_flow_kg_s for r in records])
    sds = np.array([r.shape_std_dev_kg_s for r in records])
    assert np.all(np.abs(flows - FLOW_KG_S) < 3.0 * sds)
    assert flows.mean() == pytest.approx(FLOW_KG_S, rel=0.06)
    assert not any(r.faults for r in records)


NARROW = {
    "load": (replace(LAW, fills=(0.2, 0.3)), "load 0.1[0-9] of a full paddle, calibrated 0.20 to 0.30"),
    "angle": (replace(LAW, plate_angles_rad=tuple(np.deg2rad([40.0, 60.0]))), "plate at 70 deg, calibrated 40 to 60 deg"),
    "speed": (
        replace(LAW, elevator_speeds_rad_s=(500.0 * RPM, 500.0 * RPM)),
        "elevator at 39[0-9] rpm, calibrated 500 to 500 rpm",
    ),
    "no file": (None, "no pulse-shape file"),
}


@pytest.mark.parametrize("law", NARROW)
def test_outside_what_is_calibrated_no_flow_by_shape_is_given_and_the_mean_force_counts(law: str) -> None:
    range_, reason = NARROW[law]
    waveform = replace(WaveformSettings(), shape=range_, enabled=True, combine=True)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))
    records = records_in(monitor.feed_run(as_run(traffic())))[-10:]
    assert {r.shape_verdict for r in records} == {ShapeVerdict.OUTSIDE_CALIBRATION}
    assert all(np.isnan(r.shape_flow_kg_s) and np.isnan(r.shape_volume_flow_m3_s) for r in records)
    assert [r.mass_kg for r in records] == [r.mass_kg for r in harvested()]
    assert monitor.waveform is not None
    assert re.match(reason, monitor.waveform.shape_reason)
    assert not monitor.waveform.contradiction


def test_within_the_range_records_say_that_the_shape_is_used() -> None:
    assert {r.shape_verdict for r in harvested(enabled=True)} == {ShapeVerdict.USED}
    assert {r.shape_verdict for r in harvested()} == {ShapeVerdict.NOT_LOOKED_AT}


def test_a_zero_or_speed_that_is_missing_is_not_called_missing_samples() -> None:
    monitor = looking(replace(WaveformSettings(), shape=LAW, enabled=True))
    slow = [
        frame._replace(signals={"ElevatorSpeed": 200.0}) if frame.message == ELEVATOR_SPEED and frame.time_s > 20.0 else frame
        for frame in traffic()
    ]
    verdicts = [record.shape_verdict for record in records_in(monitor.feed_run(as_run(slow)))]
    without = next(place for place, verdict in enumerate(verdicts) if verdict is not ShapeVerdict.NO_ZERO)
    assert without >= 1
    assert ShapeVerdict.NO_SAMPLES not in verdicts
    assert verdicts[-1] is ShapeVerdict.SPEED_OUT_OF_RANGE
    assert monitor.waveform is not None
    assert monitor.waveform.shape_reason == "the elevator speed is outside the measuring range"


def test_the_terms_of_the_file_move_the_flow() -> None:
    """Discrete elements' stretch and tail make the virtual combine's pulses, which have neither, those of a smaller load."""
    plain, terms = (np.nanmean([r.shape_flow_kg_s for r in harvested(enabled=True, shape_terms=t)]) for t in (False, True))
    assert terms < 0.9 * plain


def test_a_slow_cell_hides_the_kernels() -> None:
    """The virtual combine's 8 ms cell: a thousand-kernel weight is reported, and still no flow is published from kernels."""
    records = harvested(enabled=True, thousand_kernel_weight_g=350.0)
    assert {r.thousand_kernel_weight_g for r in records[-15:]} == {350.0}
    assert np.isnan([r.kernel_flow_kg_s for r in records]).all()


def test_the_switch_counts_and_publishes_both_together() -> None:
    apart, both = harvested(enabled=True), harvested(enabled=True, combine=True)
    for one, other in zip(apart, both, strict=True):
        low, high = sorted((one.mass_kg, one.shape_flow_kg_s * one.duration_s))
        assert 0.97 * low < other.mass_kg < 1.03 * high
    assert [r.mass_kg for r in both] != [r.mass_kg for r in apart]


@pytest.mark.parametrize(("mean_sd", "shape_sd", "nearer"), [(0.10, 0.01, "shape"), (0.01, 0.10, "mean")])
def test_the_combination_leans_on_the_surer(mean_sd: float, shape_sd: float, nearer: str) -> None:
    sure = replace(PARAMETERS, covariance=np.diag([1e-6, 1.0, 1e-6]))
    found = combine(8.0, mean_sd, 9.0, shape_sd, exponent=0.75, parameters=sure)
    assert abs(found.mass_flow_kg_s - (9.0 if nearer == "shape" else 8.0)) < 0.1
    assert found.relative_sd <= min(mean_sd, shape_sd) * 1.01
    assert found.z == pytest.approx(np.log(9.0 / 8.0) / np.hypot(mean_sd, shape_sd), rel=0.02)


def test_without_a_shape_the_mean_force_stands() -> None:
    found = combine(8.0, 0.05, float("nan"), float("nan"), exponent=0.75, parameters=PARAMETERS)
    assert (found.mass_flow_kg_s, found.relative_sd, found.weight) == (8.0, 0.05, 0.0)


@cache
def struck(response_s: float) -> tuple[Frame, ...]:
    """Kernels of 350 mg through a cell, their weight in frames; the last eighteen seconds with grain."""
    pieces = [{"kind": "steady", "duration_s": 14, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 20, "flow_kg_s": FLOW_KG_S}]
    values = {
        "duration_s": 32, "flow": {"pieces": pieces}, "kernels": {"thousand_kernel_weight_g": 350},
        "frames": {"kernel_weight": True}, "sensor": {"response_s": response_s},
    }  # fmt: skip
    return tuple(VirtualCombine(from_mapping(values, "test"), seed=5).frames_until(32.0))


@cache
def monitored(response_s: float, weight_g: float = 0.0, *, reported: bool = False) -> Monitor:
    """At the end of that traffic. reported: the weight comes in frames."""
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=weight_g, quiet_windows=2)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    machine = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=response_s))
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    monitor.feed_run(as_run(struck(response_s), kernels=reported))
    return monitor


@pytest.mark.parametrize(
    ("response_s", "verdict"),
    [
        (2e-4, KernelVerdict.USED),
        (8e-3, (KernelVerdict.NO_NOISE, KernelVerdict.BACKGROUND, KernelVerdict.SLOW_CELL, KernelVerdict.UNEVEN)),
    ],
)
def test_says_whether_the_cell_lets_kernels_through(response_s: float, verdict: object) -> None:
    seen = monitored(response_s, 175.0).waveform
    assert seen is not None
    assert seen.kernels in np.atleast_1d(verdict)
    assert (seen.kernels_kg_s > 0.0) is (seen.kernels is KernelVerdict.USED)
    assert bool(seen.kernels_reason) is (seen.kernels is not KernelVerdict.USED)
    assert seen.volume_m3_s * VALUES["density"] == pytest.approx(seen.shape_kg_s)


@pytest.mark.parametrize("delay_ms", [1.0, 4.0])
def test_frames_that_the_bus_delays_give_the_flows_of_frames_in_time(delay_ms: float) -> None:
    """Samples are taken by the sensor's clock; delays of 5 ms laid pulses beside one another, three times the kernels' noise."""
    rng = np.random.default_rng(31)
    before_s, late = 0.0, []
    for frame in struck(2e-4):
        if frame.message == "ImpactSensorSamples":
            before_s = max(frame.time_s + 1e-3 * delay_ms * rng.exponential(), before_s + 1e-4)
            late.append(frame._replace(time_s=before_s))
        elif frame.message != GRAIN_KERNELS:
            late.append(frame)
    late.sort(key=lambda frame: frame.time_s)
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=350.0, quiet_windows=2)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, FAST, OpenLoop(ForwardModel(FAST, PARAMETERS.effects), PARAMETERS))
    monitor.feed_run(run_of(late))
    seen, in_time = monitor.waveform, monitored(2e-4, 350.0).waveform
    assert seen is not None
    assert in_time is not None
    assert seen.kernels_kg_s == pytest.approx(in_time.kernels_kg_s, rel=0.1)
    assert seen.shape_kg_s == pytest.approx(in_time.shape_kg_s, rel=0.1)


def test_a_frame_s_kernel_weight_takes_precedence() -> None:
    """In the frame 350 g, entered 175 g; flow is in proportion."""
    heard, reported = monitored(2e-4, 175.0, reported=True), monitored(2e-4, 175.0)
    assert heard.waveform is not None
    assert reported.waveform is not None
    assert (heard.waveform.kernel_weight_g, reported.waveform.kernel_weight_g) == (350.0, 175.0)
    assert heard.waveform.kernels_kg_s == pytest.approx(2.0 * reported.waveform.kernels_kg_s, rel=0.02)
    assert abs(heard.waveform.kernels_kg_s - FLOW_KG_S) < 2.0 * heard.waveform.kernels_std_dev_kg_s


def test_without_a_weight_it_says_that_this_is_what_is_missing() -> None:
    seen = monitored(2e-4).waveform
    assert seen is not None
    assert (seen.kernels, seen.kernels_reason) == (KernelVerdict.NO_KERNEL_WEIGHT, "no thousand-kernel weight is known")


@pytest.mark.parametrize("needed", [1, 4])
def test_kernels_are_heard_after_so_many_seconds_of_the_empty_machine_and_of_grain(needed: int) -> None:
    """Each second before says how many it has; the one that completes them is the first that is judged."""
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=175.0, quiet_windows=needed)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    machine = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=2e-4))
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    results = windows_in(monitor.feed_run(as_run(struck(2e-4))))
    seen = [(r.waveform.kernels, r.waveform.kernels_reason) for r in results if r.record.mass_flow_kg_s > 0.5 * FLOW_KG_S]
    early = [reason for verdict, reason in seen if verdict is KernelVerdict.TOO_EARLY]
    quiet = int(early[0].split(" ")[0])
    assert quiet >= needed
    told = {
        f"{quiet} s of the empty machine and {heard} s of steady grain measured, {needed} s of each needed"
        for heard in range(needed)
    }
    assert set(early) == told
    assert [verdict is KernelVerdict.TOO_EARLY for verdict, _ in seen] == [True] * len(early) + [False] * (len(seen) - len(early))


@pytest.mark.parametrize("noise_mv", [20.0, 40.0])
def test_an_empty_machine_of_a_noisy_sensor_is_heard_too(noise_mv: float) -> None:
    """Means of a second are then further from 0 than 1 mV in many seconds."""
    rng = np.random.default_rng(17)
    noisy = []
    for frame in struck(2e-4):
        samples = [name for name in frame.signals if re.fullmatch(r"Sample\d", name)]
        moved = {name: frame.signals[name] + noise_mv * rng.normal() for name in samples}
        noisy.append(frame._replace(signals={**frame.signals, **moved}))
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=350.0, quiet_windows=4)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, FAST, OpenLoop(ForwardModel(FAST, PARAMETERS.effects), PARAMETERS))
    monitor.feed_run(as_run(noisy, kernels=False))
    assert monitor.waveform is not None
    assert monitor.waveform.kernels is not KernelVerdict.TOO_EARLY


STEPS = (6.0, 14.0, 10.0)


@cache
def stepping(seed: int = 8) -> tuple[Frame, ...]:
    """Kernels through a fast cell; the flow changes every five seconds."""
    pieces = [{"kind": "steady", "duration_s": 12, "flow_kg_s": 0}, {"kind": "step", "duration_s": 15, "flows_kg_s": list(STEPS)}]
    flow = {"pieces": [pieces[0], *pieces[1:] * 4], "smoothing_s": 0.3}
    values = {"duration_s": 72, "flow": flow, "kernels": {"noise_ratio": 1.2}, "sensor": {"response_s": 2e-4}}
    return tuple(VirtualCombine(from_mapping(values, "test"), seed=seed).frames_until(72.0))


def heard(parameters: ParameterSet = PARAMETERS, **settings: object) -> tuple[list[WindowRecord], Monitor]:
    """Records of that traffic from where kernel noise gives a flow."""
    given = {"thousand_kernel_weight_g": 350.0, **settings}
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, quiet_windows=2, **given)  # type: ignore[arg-type]
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    machine = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=2e-4))
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, parameters.effects), parameters))
    records = records_in(monitor.feed_run(as_run(stepping(), kernels=False)))
    return [r for r in records if np.isfinite(r.kernel_flow_kg_s)], monitor


@pytest.mark.parametrize(
    ("scale", "weight_g", "alone"),
    [
        pytest.param(NOT_CALIBRATED, 350.0, True, id="a prior, the right weight"),
        pytest.param(NOT_CALIBRATED, 700.0, True, id="a prior, twice the weight"),
        pytest.param(WEIGHED, 350.0, False, id="weighed, the right weight"),
        pytest.param(WEIGHED, 700.0, False, id="weighed, twice the weight"),
    ],
)
def test_a_wrong_kernel_weight_contradicts_a_weighed_scale_and_beside_a_prior_is_all_there_is(
    scale: str, weight_g: float, alone: bool
) -> None:
    records, monitor = heard(replace(PARAMETERS, provenance={"scale": scale}), thousand_kernel_weight_g=weight_g)
    wrong = scale == WEIGHED and weight_g == 700.0
    assert (FaultCode.WAVEFORM_CONTRADICTS in records[-1].faults) is wrong
    assert records[-1].kernel_verdict is (KernelVerdict.CONTRADICTS if wrong else KernelVerdict.USED)
    assert monitor.only_kernels_set_scale is alone


def test_kernel_noise_gives_the_flow_where_the_flow_changes() -> None:
    """Taken off by one mean for all loads, the pulses left 1.5 times the noise of the kernels."""
    records, monitor = heard()
    assert len(records) > 25
    by_kernels, by_force = (np.array([getattr(r, n) for r in records]) for n in ("kernel_flow_kg_s", "mean_force_flow_kg_s"))
    assert by_kernels.sum() / by_force.sum() == pytest.approx(1.0, abs=0.15)
    # Seconds go with the mean force; the scale alone is the kernels'.
    assert np.std(by_kernels[-20:] / by_force[-20:]) < 0.03
    assert monitor.waveform is not None
    assert monitor.waveform.bias == pytest.approx(1.2 * by_force[-30:].sum() / by_kernels[-30:].sum(), rel=0.05)


def test_where_density_and_gain_are_uncertain_the_kernels_scale_is_counted() -> None:
    wrong = replace(PARAMETERS, values={**VALUES, "density": 935.0, "restitution": 0.4675})
    doubted = replace(wrong, covariance=np.diag([0.02**2, 165.0**2, 0.08**2]))
    records, _ = heard(doubted, combine=True, kernel_bias_sd=0.03, stretch_sd=0.2)
    force, kernels = (sum(getattr(r, n) for r in records[-15:]) for n in ("mean_force_flow_kg_s", "kernel_flow_kg_s"))
    # The mean force, whose own deviation is 13 %, is 14 % off.
    assert abs(force / kernels - 1.0) > 0.1
    assert abs(sum(r.mass_kg for r in records[-15:]) / kernels - 1.0) < 0.05
    sure, _ = heard(wrong, combine=True, kernel_bias_sd=0.5, stretch_sd=0.2)
    assert sum(r.mass_kg for r in sure[-15:]) == pytest.approx(force, rel=0.05)


def shaken(share: float) -> tuple[Frame, ...]:
    """The same with white vibration of so many times the kernels' mean power, from the first grain on."""
    rng = np.random.default_rng(19)
    # Force of 8 kg/s and a kernel's impulse in it, 350 mg of 9 N s/kg, over a millisecond.
    size_mv = np.sqrt(share * 70.0 * 3.2e-3 / 1e-3) / MACHINE.sensor.gain_n_per_mv
    out = []
    for frame in struck(2e-4):
        if frame.message == "ImpactSensorSamples" and frame.time_s > 13.5:
            moved = {n: float(v) + size_mv * rng.standard_normal() for n, v in frame.signals.items() if re.match(r"Sample\d", n)}
            out.append(frame._replace(signals={**frame.signals, **moved}))
        else:
            out.append(frame)
    return tuple(out)


def test_vibration_that_only_harvesting_has_does_not_pass_for_kernels() -> None:
    """A fifth of the kernels' noise, which took the flow 15 % down with as little stated as without."""

    def last(frames: tuple[Frame, ...]) -> tuple[float, float]:
        waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=350.0, quiet_windows=2)
        engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
        monitor = Monitor(engine, FAST, OpenLoop(ForwardModel(FAST, PARAMETERS.effects), PARAMETERS))
        monitor.feed_run(as_run(frames))
        assert monitor.waveform is not None
        return monitor.waveform.kernels_kg_s, monitor.waveform.kernels_std_dev_kg_s

    (still, still_sd), (vibrating, vibrating_sd) = last(struck(2e-4)), last(shaken(0.15))
    assert vibrating == pytest.approx(still, rel=0.06)
    assert vibrating_sd / vibrating > still_sd / still + 0.01


def test_a_scale_by_kernels_that_the_mean_force_cannot_have_is_a_contradiction() -> None:
    sure = replace(PARAMETERS, values={**VALUES, "restitution": 0.1}, covariance=np.diag([0.004**2, 11.0**2, 0.008**2]))
    records, monitor = heard(sure, kernel_bias_sd=0.03, contradiction_windows=5)
    assert FaultCode.WAVEFORM_CONTRADICTS in records[-1].faults
    assert "kernel noise and mean force differ by" in monitor.faults.detail(FaultCode.WAVEFORM_CONTRADICTS)
    assert "sensor.response_s" in monitor.faults.detail(FaultCode.WAVEFORM_CONTRADICTS)
    # Not "used": neither the published flow nor the parameters are moved by it.
    assert records[-1].kernel_verdict is KernelVerdict.CONTRADICTS


@pytest.mark.parametrize("weight_g", [0.35, 770.0])
def test_a_scale_that_contradicts_the_mean_force_corrects_nothing(weight_g: float) -> None:
    """A kernel's weight in place of a thousand's, or another crop's."""
    reported = {"thousand_kernel_weight_g": weight_g, "kernel_bias_sd": 0.03, "contradiction_windows": 500}
    together = heard(combine=True, **reported)[0]
    assert [FaultCode.WAVEFORM_CONTRADICTS in r.faults for r in together[-15:]] == [True] * 15
    # The shape, which does not contradict, still corrects: the flow lies between those two.
    for r in together[-15:]:
        low, high = sorted((r.mean_force_flow_kg_s, r.shape_flow_kg_s))
        assert 0.97 * low < r.mass_kg / r.duration_s < 1.03 * high


def test_a_shape_that_contradicts_the_mean_force_corrects_nothing() -> None:
    reported = {
        "enabled": True,
        "stretch": 1.6,
        "stretch_sd": 0.01,
        "tail_sd": 0.01,
        "model_error": 0.01,
        "contradiction_windows": 5,
    }
    apart, together = harvested(**reported), harvested(combine=True, **reported)
    assert all(FaultCode.WAVEFORM_CONTRADICTS in r.faults for r in together[-4:])
    assert [r.mass_kg for r in together[-4:]] == [r.mass_kg for r in apart[-4:]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("stretch", [1.0, 1.4])
def test_a_cell_without_a_response_gives_no_warnings_and_a_flow_by_shape(stretch: float) -> None:
    """The default of a machine file; warnings are errors here. With the second the shape is far from the mean force."""
    machine = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=0.0))
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, stretch=stretch, stretch_sd=0.05)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    records = records_in(monitor.feed_run(as_run(struck(2e-4))))
    assert records[-1].shape_verdict is ShapeVerdict.USED


def test_says_how_much_of_the_empty_machine_and_of_grain_it_has_heard() -> None:
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, quiet_windows=3000)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))
    monitor.feed_run(as_run(traffic()))
    assert monitor.waveform is not None
    assert monitor.waveform.kernels is KernelVerdict.TOO_EARLY
    said = r"(\d+) s of the empty machine and (\d+) s of steady grain measured, 3000 s of each needed"
    heard_s = re.match(said, monitor.waveform.kernels_reason)
    assert heard_s is not None
    assert all(0 < int(seconds) < 14 for seconds in heard_s.groups())


def test_a_cell_stated_wrongly_is_a_contradiction_not_a_wrong_flow() -> None:
    """The machine file says 8 ms where the cell answers in 0.2 ms."""
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False),
                     waveform=replace(WaveformSettings(), shape=LAW, enabled=True, contradiction_windows=5))  # fmt: skip
    monitor = Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))
    records = records_in(monitor.feed_run(as_run(struck(2e-4))))
    assert FaultCode.WAVEFORM_CONTRADICTS in records[-1].faults
    assert "sensor.response_s" in monitor.faults.detail(FaultCode.WAVEFORM_CONTRADICTS)


def test_the_mean_force_s_own_flow_stays_in_the_record_of_both_together() -> None:
    apart, both = harvested(enabled=True), harvested(enabled=True, combine=True)
    assert [r.mean_force_flow_kg_s for r in both] == [r.mean_force_flow_kg_s for r in apart]
    assert [r.mass_kg for r in both] != [r.mass_kg for r in apart]
    assert all(np.isnan(r.mean_force_flow_kg_s) for r in harvested())


def monitor_with_both(**arguments: bool) -> Monitor:
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, combine=True, thousand_kernel_weight_g=350.0, quiet_windows=2)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    return Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS), **arguments)


def test_samples_looked_at_after_the_frames_are_out_change_neither_frames_nor_records() -> None:
    at_once, later = monitor_with_both(), monitor_with_both(waveform_later=True)
    for frame in traffic():
        expected, handed_out = at_once.feed(frame), later.feed(frame)
        assert [result.frames for result in handed_out] == [result.frames for result in expected]
        assert not any(window.record.shape_flow_kg_s > 0.0 for window in windows_in(handed_out))
        assert repr(later.completed(handed_out)) == repr(expected)
    assert at_once.waveform is not None
    assert at_once.waveform.shape is ShapeVerdict.USED


def test_windows_that_close_together_are_completed_as_if_one_after_the_other() -> None:
    at_once, later = monitor_with_both(), monitor_with_both(waveform_later=True)
    frames = [frame for frame in traffic() if not 20.5 < frame.time_s < 23.5]
    several = 0
    for frame in frames:
        expected, handed_out = at_once.feed(frame), later.feed(frame)
        several = max(several, len(windows_in(handed_out)))
        assert repr(later.completed(handed_out)) == repr(expected)
    assert several >= 3


def test_results_that_are_not_completed_leave_the_later_ones_as_they_are() -> None:
    at_once, later, compared = monitor_with_both(), monitor_with_both(waveform_later=True), 0
    for frame in traffic():
        expected, handed_out = at_once.feed(frame), later.feed(frame)
        if frame.time_s > 22.0:
            assert repr(later.completed(handed_out)) == repr(expected)
            compared += len(windows_in(expected))
    assert compared > 3


def test_a_log_in_bulk_says_what_its_frames_one_by_one_say(tmp_path: Path) -> None:
    """Windows are fitted side by side in bulk."""
    with can.Logger(str(tmp_path / "a.log")) as log:
        for frame in traffic():
            message = CODEC.encode(frame)
            message.channel = "can0"
            log.on_message_received(message)

    def monitor() -> Monitor:
        waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=350.0, quiet_windows=2)
        engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
        return Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))

    rows: list[SecondRow] = []
    together: list[WindowResult] = []
    process_in_bulk(
        [tmp_path / "a.log"], monitor(), CODEC, rows.append, take_results=lambda found: together.extend(windows_in(found))
    )
    alone = monitor()
    with can.LogReader(str(tmp_path / "a.log")) as log:
        frames = [frame for message in log if (frame := CODEC.decode(message)) is not None]
    windows = [window for frame in frames for window in windows_in(alone.feed(frame))]
    records = [window.record for window in windows]
    assert len(rows) == len(records)
    assert sum(row.shape_flow_kg_s is not None for row in rows) >= 10
    for row, record in zip(rows, records, strict=True):
        assert row.shape_verdict == (record.shape_verdict.name.lower() if record.shape_verdict else None)
        assert row.kernel_verdict == (record.kernel_verdict.name.lower() if record.kernel_verdict else None)
        for name in ("shape_flow_kg_s", "shape_std_dev_kg_s", "shape_volume_flow_m3_s", "mass_kg"):
            shown = getattr(row, name)
            assert (np.nan if shown is None else shown) == pytest.approx(getattr(record, name), rel=1e-9, nan_ok=True), name
    # The wave of each window leaves with it, however many close at once.
    assert len(together) == len(windows)
    for one, other in zip(together, windows, strict=True):
        assert (one.waveform.wave is None) is (one.record.shape_verdict is not ShapeVerdict.USED)
        assert (other.waveform.wave is None) is (one.waveform.wave is None)
        if one.waveform.wave is not None:
            assert one.waveform.wave.elevator_speed_rad_s == one.record.elevator_speed_rad_s
            np.testing.assert_allclose(one.waveform.wave.amplitudes_n, other.waveform.wave.amplitudes_n, rtol=1e-9)


@pytest.mark.parametrize("same", [True, False])
def test_a_reload_keeps_the_noise_that_was_heard_where_machine_and_settings_stay(same: bool) -> None:
    before = monitored(2e-4, 350.0)
    machine = before.machine if same else replace(before.machine, paddle_spacings_m=(0.18635,))
    after = Monitor(before.settings, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    after.restore(before.snapshot())
    after.take_over(before, tickets=False)
    later = [frame._replace(time_s=frame.time_s + 5.0) for frame in struck(2e-4) if frame.time_s > 27.0]
    seen = [r.kernel_verdict for frame in later for r in records_in(after.feed(frame))]
    assert (KernelVerdict.USED in seen) is same


def learner(parameters: ParameterSet, machine: Machine, **settings: object) -> Monitor:
    """Kernel noise updates the parameters every ten seconds of grain."""
    given = {"thousand_kernel_weight_g": 350.0, "update_parameters": True, "update_windows": 10, "kernel_windows": 5, **settings}
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, quiet_windows=2, **given)  # type: ignore[arg-type]
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    model = ForwardModel(machine, parameters.effects)
    return Monitor(engine, machine, OpenLoop(model, parameters), ClosedLoopCalibrator(model))


FAST = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=2e-4))
DOUBTED = replace(
    PARAMETERS, values={**VALUES, "density": 935.0, "restitution": 0.4675}, covariance=np.diag([0.02**2, 165.0**2, 0.08**2])
)


def listened(monitor: Monitor, frames: tuple[Frame, ...]) -> tuple[list[WindowRecord], list[ParametersChanged]]:
    results = windows_in(monitor.feed_run(as_run(frames, kernels=False)))
    return [r.record for r in results], [e for r in results for e in r.events if isinstance(e, ParametersChanged)]


def least_stated(records: list[WindowRecord]) -> float:
    """Relative standard deviation of flow in the best of these windows."""
    return min(r.std_dev_kg_s / r.mass_flow_kg_s for r in records)


def test_a_scale_that_kernels_update_is_off_by_no_more_than_is_stated() -> None:
    """Updates of five windows each err by some 4 % by the kernels' chance; the parameters measure more than 10 % too much."""
    errors = []
    for seed in (1, 2, 3, 4):
        last = listened(learner(DOUBTED, FAST, kernel_bias_sd=0.03), stepping(seed))[0][-15:]
        errors.append(sum(r.mass_kg for r in last) / (5.0 * sum(STEPS)) - 1.0)
        assert abs(errors[-1]) < 2.0 * least_stated(last)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.06)


def test_kernels_update_the_parameters_and_are_then_not_counted_a_second_time() -> None:
    sure = {"kernel_bias_sd": 0.03}
    records, changes = listened(learner(DOUBTED, FAST, **sure), stepping())
    assert len(changes) >= 3
    assert {change.origin for change in changes} == {"kernels"}
    assert all(re.match(r"kernel noise moved the scale by [+-][\d.]+ %; its bias is known to", c.reason) for c in changes)
    true_kg = 5.0 * sum(STEPS)
    assert abs(sum(r.mass_kg for r in records[-15:]) / true_kg - 1.0) < 2.0 * least_stated(records[-15:])
    assert sum(r.mass_kg for r in heard(DOUBTED, **sure)[0][-15:]) > 1.1 * true_kg
    together, _ = listened(learner(DOUBTED, FAST, combine=True, stretch_sd=1.0, **sure), stepping())
    assert sum(r.mass_kg for r in together[-15:]) == pytest.approx(sum(r.mass_kg for r in records[-15:]), rel=0.02)


@pytest.mark.parametrize("scale", [NOT_CALIBRATED, "", WEIGHED])
def test_a_scale_by_kernels_alone_is_said_to_rest_on_their_weight(scale: str) -> None:
    known = replace(DOUBTED, provenance={"scale": scale} if scale else {})
    monitor = learner(known, FAST, thousand_kernel_weight_g=400.0)
    _, changes = listened(monitor, stepping())
    rests = [change.reason.endswith("; no weighed load confirms the kernel weight on which it rests") for change in changes]
    assert set(rests) == {scale == NOT_CALIBRATED}


def test_the_bias_outlives_a_restart_with_the_parameters_that_it_updated() -> None:
    monitor = learner(DOUBTED, FAST)
    listened(monitor, stepping())
    state, known = monitor.snapshot(), monitor.estimator.parameters
    assert known.provenance["kernel_noise"] == "updated"
    kept = EngineState.from_dict(json.loads(json.dumps(asdict(state))))
    assert kept.calibrator is not None
    assert kept.calibrator.bias[1] < 0.2**2
    later = tuple(frame._replace(time_s=frame.time_s + 100.0) for frame in stepping())
    for restored, changes_expected in ((kept, True), (replace(kept, calibrator=None), False)):
        after = learner(known, FAST)
        after.restore(restored)
        _, changes = listened(after, later)
        assert bool(changes) is changes_expected
        # Where it is not known what of the parameters is the bias's, nothing that kernels say is taken as new.
        assert ("does so again after a weighed load" in (after.outcome.reason if after.outcome else "")) is not changes_expected


def test_channels_that_lie_apart_widen_what_is_stated() -> None:
    """By kernels a third of the flow by the mean force; neither excludes the other at these deviations."""
    doubted = replace(PARAMETERS, covariance=np.diag([0.02**2, 66.0**2, 0.2**2]))
    stated = []
    for weight_g in (350.0, 250.0):
        records, _ = heard(doubted, combine=True, kernel_bias_sd=0.15, stretch_sd=1.0, thousand_kernel_weight_g=weight_g)
        last = records[-1]
        assert FaultCode.WAVEFORM_CONTRADICTS not in last.faults
        stated.append(last.std_dev_kg_s / last.mass_flow_kg_s)
    assert stated[1] > 1.3 * stated[0]


def by_kernels(**elevator: float) -> Monitor:
    """After 48 s of grain whose kernels a cell of 0.2 ms shows."""
    pieces = [{"kind": "steady", "duration_s": 12, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 48, "flow_kg_s": FLOW_KG_S}]
    kernels, sensor = {"noise_ratio": 1.2}, {"response_s": 2e-4}
    values = {"duration_s": 60, "flow": {"pieces": pieces}, "kernels": kernels, "sensor": sensor, "elevator": elevator}
    waveform = replace(WaveformSettings(), shape=LAW, enabled=True, thousand_kernel_weight_g=350.0, quiet_windows=2)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, FAST, OpenLoop(ForwardModel(FAST, PARAMETERS.effects), PARAMETERS))
    for frame in VirtualCombine(from_mapping(values, "test"), seed=8).frames_until(60.0):
        monitor.feed(frame)
    return monitor


def test_kernel_noise_of_a_chain_that_jerks_gives_no_flow() -> None:
    """Between the speeds that are reported; pulses out of place pass for kernels, by which the flow would be a third too low."""
    even, jerking = (by_kernels(noise_pct=pct, noise_time_s=s).waveform for pct, s in ((0.3, 2.0), (1.5, 0.1)))
    assert even is not None
    assert jerking is not None
    assert even.kernels is KernelVerdict.USED
    assert even.kernels_kg_s == pytest.approx(FLOW_KG_S, rel=0.15)
    assert even.kernels_std_dev_kg_s < 0.14 * even.kernels_kg_s
    assert np.isnan(jerking.kernels_kg_s)
    assert "does the chain jerk" in jerking.kernels_reason
