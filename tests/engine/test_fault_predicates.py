"""Each fault's condition at its limit and beyond, on a second of harvest in which all else is well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import nan, nextafter
from types import SimpleNamespace
from typing import Any

import pytest
from engine_bench import MACHINE, ForceProportional
from test_measurement_by_a_table import Seconds

from yieldmon.engine.faults import FaultCode, Observation
from yieldmon.engine.flow import Circumstances, Estimate, FlowMeter
from yieldmon.engine.health import conditions
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.zero import ZeroRefusal
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.waveform.waveform_reading import NOTHING
from yieldmon.estimation.open_loop import FlowStatus
from yieldmon.frames import ScaleStatus
from yieldmon.physics.machine import RPM

SETTINGS = EngineSettings()
F = FaultCode
FULL, SLOWEST = SETTINGS.windows.full_coverage, MACHINE.min_elevator_speed_rad_s
TURNING, STANDING = (SETTINGS.gate.min_turning_rpm * share * RPM for share in (1.001, 0.999))
STABLE, FAULT = float(ScaleStatus.STABLE.value), float(ScaleStatus.FAULT.value)
HELD_S = SETTINGS.inputs.sensor_timeout_s
NONE_MISSING = ", no frame missing: if this persists, check rate_hz"
TENTH_UNUSABLE = "; 10 % of the received samples are not available or outside the sensor's range"


def harvest(**of: Any) -> Reading:
    machine = Seconds()
    machine.harvest(3)
    return machine.harvest(**of)


def seen(reading: Reading | None = None, *, status: FlowStatus = FlowStatus.OK, **beside: Any) -> dict[FaultCode, str]:
    """The conditions that hold; beside: what the observation has otherwise than on a good second."""
    reading = harvest() if reading is None else reading
    estimate = Estimate(15.0, 0.8, status, 0.3)
    flow = FlowMeter(SETTINGS, MACHINE).flow(
        reading, estimate, ForceProportional(), Circumstances(sweeping=False, calibration_old=False)
    )
    good = {
        "reading": reading, "flow": flow, "sweep": SimpleNamespace(not_following=False, abort_reason=None), "outcome": None,
        "disagreement": SimpleNamespace(present=False, region="at 50 deg"), "calibration_age_s": 0.0, "settings": SETTINGS,
        "waveform": NOTHING, "mass_near_end": None, "scale_alarm": None,
    }  # fmt: skip
    return conditions(Observation(**good | beside))  # type: ignore[arg-type]


def outcome(*, identifiable: bool, weighed: bool) -> SimpleNamespace:
    return SimpleNamespace(identifiable=identifiable, weighed=weighed, reason="as before")


def scale(now: float, ever: float) -> Reading:
    return harvest(fresh={"tank_scale_status": now}, in_scale_status=ever)


def since(windows: int) -> dict[FaultCode, str]:
    return seen(replace(harvest(), windows_since_jump=windows))


def covered(share: float, **of: Any) -> dict[FaultCode, str]:
    return seen(harvest(covered_s=share, **of))


def refused(waited_s: float) -> dict[FaultCode, str]:
    return seen(replace(harvest(), zero_refusal=ZeroRefusal(waited_s, 14.0, 5.0)))


CASES: dict[str, tuple[Callable[[], dict[FaultCode, str]], dict[FaultCode, str]]] = {
    "all well": (seen, {}),
    "no sample": (
        lambda: seen(harvest(samples=0, covered_s=0.0, lost_frames=250)),
        {F.SENSOR_MISSING: "0 usable samples in the window", F.FRAMES_LOST: "250 lost, 0 too many"}),
    "half of the frames with a fault": (lambda: seen(harvest(sensor_fault_frames=125)), {}),
    "more than half": (lambda: seen(harvest(sensor_fault_frames=126)), {F.SENSOR_MISSING: "1000 usable samples in the window"}),
    "not yet stuck": (lambda: seen(replace(harvest(), stuck_s=4)), {}),
    "stuck": (lambda: seen(replace(harvest(), stuck_s=5)), {F.SENSOR_STUCK: "no change for 5 s"}),
    "few saturated": (lambda: seen(harvest(saturated_share=nextafter(0.01, 0.0))), {}),
    "saturated": (lambda: seen(harvest(saturated_share=0.01)), {F.SENSOR_SATURATED: "1 % of the samples"}),
    "zero drifted": (lambda: seen(replace(harvest(), zero_drift="the zero is +60 mV from its first value")), {
        F.ZERO_DRIFTED: "the zero is +60 mV from its first value"
    }),
    "speed missing": (lambda: seen(replace(harvest(), speed_known=False)), {F.SPEED_MISSING: ""}),
    "as slow as may be": (lambda: seen(harvest(speed_rad_s=SLOWEST)), {}),
    "too slow": (lambda: seen(harvest(speed_rad_s=nextafter(SLOWEST, 0.0))), {F.SPEED_OUT_OF_RANGE: "250 rpm"}),
    "hardly turning": (lambda: seen(harvest(speed_rad_s=TURNING)), {F.SPEED_OUT_OF_RANGE: "50 rpm"}),
    "standing": (lambda: seen(harvest(speed_rad_s=STANDING)), {}),
    "standing, with grain for a while": (lambda: seen(replace(harvest(speed_rad_s=STANDING), struck_s=4)), {}),
    "standing, with grain for longer": (
        lambda: seen(replace(harvest(speed_rad_s=0.0), struck_s=5)), {F.SPEED_MISSING: "0 rpm, but grain strikes the plate"}),
    "too slow at an unknown speed": (
        lambda: seen(replace(harvest(speed_rad_s=TURNING), speed_known=False)), {F.SPEED_MISSING: ""}),
    "plate does not follow": (
        lambda: seen(sweep=SimpleNamespace(not_following=True, abort_reason=None)), {F.PLATE_NOT_FOLLOWING: ""}),
    "angle stale": (lambda: seen(harvest(in_angle_deg=nan)), {F.PLATE_FEEDBACK_STALE: ""}),
    "sweep ended early": (
        lambda: seen(sweep=SimpleNamespace(not_following=False, abort_reason="unsteady")), {F.SWEEP_ABORTED: "unsteady"}),
    "calibration of a month ago": (lambda: seen(calibration_age_s=30.0 * 86400.0), {}),
    "older": (lambda: seen(calibration_age_s=30.0 * 86400.0 + 1.0), {F.CALIBRATION_OLD: ""}),
    "of unknown age": (lambda: seen(calibration_age_s=None), {}),
    "outside calibration": (
        lambda: seen(status=FlowStatus.OUTSIDE_CALIBRATION), {F.FLOW_OUTSIDE_CALIBRATION: "15.0 kg/s"}),
    "the last of the grain at a stop": (lambda: seen(replace(harvest(), force_n=0.6), status=FlowStatus.OUTSIDE_CALIBRATION), {}),
    "above a full paddle": (
        lambda: seen(status=FlowStatus.SATURATED), {F.FLOW_OUTSIDE_CALIBRATION: "15.0 kg/s"}),
    "above a full paddle with a saturated sensor": (
        lambda: seen(harvest(saturated_share=0.02), status=FlowStatus.SATURATED), {F.SENSOR_SATURATED: "2 % of the samples"}),
    "a sweep told nothing": (
        lambda: seen(outcome=outcome(identifiable=False, weighed=False)), {F.NOT_IDENTIFIABLE: "as before"}),
    "a sweep told something": (lambda: seen(outcome=outcome(identifiable=True, weighed=False)), {}),
    "a ticket": (lambda: seen(outcome=outcome(identifiable=False, weighed=True)), {}),
    "model disagrees": (
        lambda: seen(disagreement=SimpleNamespace(present=True, region="at 50 deg")), {F.MODEL_DISAGREES: "at 50 deg"}),
    "a frame lost": (lambda: seen(harvest(lost_frames=1)), {F.FRAMES_LOST: "1 lost, 0 too many"}),
    "two senders": (
        lambda: seen(harvest(surplus_frames=9, disputed="elevator speed")),
        {F.FRAMES_LOST: "0 lost, 9 too many; two nodes send elevator speed"}),
    "two scales": (
        lambda: seen(harvest(in_tank_disputed=True)), {F.FRAMES_LOST: "0 lost, 0 too many; two nodes send tank mass"}),
    "two of each": (
        lambda: seen(harvest(surplus_frames=9, disputed="plate angle", in_tank_disputed=True)),
        {F.FRAMES_LOST: "0 lost, 9 too many; two nodes send plate angle and tank mass"}),
    "whole enough": (lambda: covered(FULL), {}),
    "not whole": (lambda: covered(nextafter(FULL, 0.0)), {F.FRAMES_LOST: "samples for 98 % of the second" + NONE_MISSING}),
    "not whole, since samples are not available": (
        lambda: covered(0.5, samples=900), {F.FRAMES_LOST: "samples for 50 % of the second" + TENTH_UNUSABLE}),
    "hardly any of them": (
        lambda: covered(0.5, samples=995), {F.FRAMES_LOST: "samples for 50 % of the second" + NONE_MISSING}),
    "lost by a counter for which the samples leave no room": (
        lambda: seen(harvest(lost_frames=5)),
        {F.FRAMES_LOST: "5 lost, 0 too many; samples cover the whole second: they arrive in bursts, or the mapping's "
         "counter is wrong"}),
    "lost in a silence before": (
        lambda: seen(replace(harvest(lost_frames=3544, covered_s=0.84), sampled_before=False, silent_before=True)),
        {F.FRAMES_LOST: "3544 lost, 0 too many; they were lost while no samples came"}),
    "lost with room": (lambda: seen(harvest(lost_frames=5, covered_s=0.98)), {F.FRAMES_LOST: "5 lost, 0 too many"}),
    "not measured at all": (lambda: covered(0.0), {}),
    "the sensor began": (lambda: seen(replace(harvest(covered_s=0.5), sampled_before=False)), {}),
    "it ended": (lambda: covered(0.5, last_frame_s=7.0 - nextafter(HELD_S, 1.0)), {}),
    "it goes on": (
        lambda: covered(0.5, last_frame_s=7.0 - 0.5 * HELD_S), {F.FRAMES_LOST: "samples for 50 % of the second" + NONE_MISSING},
    ),
    "clock jumped": (lambda: since(0), {F.CLOCK_JUMPED: ""}),
    "ten seconds ago": (lambda: since(9), {F.CLOCK_JUMPED: ""}),
    "longer ago": (lambda: since(10), {}),
    "scale stable": (lambda: seen(scale(STABLE, STABLE)), {}),
    "scale with a fault": (lambda: seen(scale(FAULT, FAULT)), {F.SCALE_FAULT: "reports a fault"}),
    "scale gone silent": (lambda: seen(scale(nan, STABLE)), {F.SCALE_FAULT: "silent"}),
    "no scale": (lambda: seen(scale(nan, nan)), {}),
    "no zero for long": (
        lambda: refused(60.0),
        {F.ZERO_MISSING: "no zero in 60 s: pulses of 14.0 mV (limit 12 mV), level within 5.0 mV (limit 3 mV)"}),
    "not yet for long": (lambda: refused(nextafter(60.0, 0.0)), {}),
    "waveform contradicts": (
        lambda: seen(waveform=replace(NOTHING, contradiction="by 9 %")), {F.WAVEFORM_CONTRADICTS: "by 9 %"}),
    "mass near its end": (lambda: seen(mass_near_end="LoadMass"), {F.MASS_NEAR_END: "LoadMass"}),
    "a weighed mass contradicts": (lambda: seen(scale_alarm="load 3"), {F.SCALE_DISAGREES: "load 3"}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_condition(case: str) -> None:
    found, expected = CASES[case]
    assert found() == expected


def test_every_condition_that_the_engine_judges_is_met_above() -> None:
    met = {code for _, expected in CASES.values() for code in expected}
    reported = {F.STORE_FAILING, F.BUS_ERROR, F.OUTPUT_CONFLICT, F.NETWORK_FAULT}
    assert met == set(FaultCode) - reported
