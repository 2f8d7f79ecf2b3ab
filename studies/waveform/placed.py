"""What the daemon says of kernel noise where discrete-element pulses come in and out of place: through the monitor.

Forces are those of `kernels.heaps`, chains those of `placed_pulses`. The mean force and the bias of kernels are set right on even
chains with other seeds, so that what a row is off by is what its chain does, and the chance of a minute.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any
from unittest import mock

import numpy as np

from studies.waveform.fill import MACHINE
from studies.waveform.kernels import FORCES, INTERVAL_S, MORE_FORCES, Heaps, heaps
from studies.waveform.placed_pulses import SAMPLE_S, Array, Chain, Train, train
from yieldmon import frames
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import windows_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.engine.waveform import kernel_channel
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.waveform.kernel_noise import KernelNoiseSettings, KernelVerdict
from yieldmon.files import pulse_shape_file
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

END_S, SETTLED_S, RPM_TOLD = 85.0, 60.0, 400.0
CALIBRATIONS = 3
"""Trains that the bias of kernels is found on."""
BIAS_SD, WEIGHT_SD = 0.03, 0.01
CELLS_S = (0.0002, 0.001, 0.003, 0.008)
GROUPS: dict[str, tuple[float, float, float]] = {
    "0.2 kg": (0.8096, 0.2, 70.0), "0.5 kg": (0.8096, 0.5, 70.0),
    "0.2 kg, light": (0.4048, 0.2, 70.0), "0.5 kg, light": (0.4048, 0.5, 70.0),
}  # fmt: skip
"""Kernel's mass, g; load, kg; plate angle, deg; of all restitutions, for the more heaps there are the less of the kernels' own
noise is in their mean."""
CHAINS: dict[str, Chain] = {
    "even": Chain(),
    "even, loads scatter by 15 %": Chain(load_scatter=0.15),
    "polygon of 8 teeth": Chain(polygon=True),
    "paddles worn by 0.3 mm": Chain(worn_mm=0.3),
    "by 0.6 mm": Chain(worn_mm=0.6),
    "by 1 mm": Chain(worn_mm=1.0),
    "by 2 mm": Chain(worn_mm=2.0),
    "slack, 0.3 mm in 0.2 s": Chain(slack_mm=0.3),
    "1 mm": Chain(slack_mm=1.0),
    "3 mm": Chain(slack_mm=3.0),
    "1 mm in 2 s": Chain(slack_mm=1.0, slack_s=2.0),
    "3 mm in 2 s": Chain(slack_mm=3.0, slack_s=2.0),
    "torsion 0.5 % at 6.7 Hz": Chain(ripple=0.005),
    "2 %": Chain(ripple=0.02),
    "5 %": Chain(ripple=0.05),
    "2 % at 30 Hz": Chain(ripple=0.02, ripple_hz=30.0),
    "10 % at 30 Hz": Chain(ripple=0.1, ripple_hz=30.0),
    "one of 36 late by 5 mm": Chain(late_mm=5.0, late_paddles=1),
    "by 20 mm, 0.7 of its throw": Chain(late_mm=20.0, late_paddles=1, late_share=0.7),
    "four of 36 so": Chain(late_mm=20.0, late_paddles=4, late_share=0.7),
    "one of 36 missing": Chain(missing=1),
    "four of 36 missing": Chain(missing=4),
    "speeds told with 2 rpm": Chain(told_rpm=2.0),
    "speeds told 0.3 % high": Chain(told_share=1.003),
    "speeds told 1 % high": Chain(told_share=1.01),
}


def of_group(pulses: Heaps, key: tuple[float, ...]) -> Heaps:
    """The heaps of one group of `GROUPS`."""
    return pulses.take(np.all(np.isclose(pulses.keys[:, [0, 1, 3]], np.array(key), rtol=1e-3), axis=1))


def traffic(made: Train, chain: Chain, angle_deg: float, seed: int) -> list[Frame]:
    """Frames of samples, speed and plate angle."""
    rng = np.random.default_rng([seed, 7])
    out = []
    for number, four in enumerate(made.samples_mv.reshape(-1, 4)):
        at_s = 4.0 * SAMPLE_S * (number + 1)
        volts = {f"Sample{k}": float(v) for k, v in enumerate(four)}
        out.append(Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, {**volts, "SampleCounter": number % 256, "SensorStatus": 0}))
        if number % 25 == 0:
            told = RPM_TOLD * chain.told_share + chain.told_rpm * rng.standard_normal()
            out.append(Frame(at_s, frames.ELEVATOR_SPEED, {"ElevatorSpeed": told}))
        if number % 12 == 0:
            out.append(Frame(at_s, frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": angle_deg, "ActuatorState": 0}))
    return out


class Judge:
    """A group of heaps behind a cell, its mean force set right, and the bias of kernels too unless it is given.

    limit: relative deviation from which no flow is given; above the daemon's own it is seen what that would have been off by.
    """

    def __init__(
        self, pulses: Heaps, key: tuple[float, float, float], cell_s: float, seed: int, *, bias: float | None = None,
        limit: float = KernelNoiseSettings().largest_sd,
    ) -> None:  # fmt: skip
        self._limit = limit
        self.kernel_g, self.load_kg, self.angle_deg = key
        self._pulses, self._cell_s = of_group(pulses, key), cell_s
        self._machine: Machine = replace(MACHINE, sensor=replace(MACHINE.sensor, response_s=cell_s))
        self._values = {
            "friction": 0.3, "density": 710.0, "shape_ratio": 2.9, "restitution": 0.3, "gravity.acceleration_m_s2": 9.81,
        }  # fmt: skip
        at = Conditions(np.deg2rad(self.angle_deg), RPM_TOLD * RPM, paddle_mass_kg=np.array(self.load_kg))
        expected = float(ForwardModel(self._machine, ("gravity",)).paddle_momentum(at, self._values))
        impulse = float(self._pulses.force_n.sum(axis=1).mean()) * INTERVAL_S
        self._values["restitution"] = 1.3 * impulse / expected - 1.0
        self.bias = 1.0 if bias is None else bias
        if bias is None:
            self.bias = 1.0 / float(np.mean([self._over_true(Chain(), seed + n)[0] for n in range(CALIBRATIONS)]))

    def row(self, chain: Chain, seed: int) -> dict[str, Any]:
        """Error of the flow by kernels, what is stated with it, and in which share of the windows the daemon would refuse it."""
        over, stated, verdicts = self._over_true(chain, seed)
        own = np.sqrt(np.maximum(stated**2 - BIAS_SD**2 - WEIGHT_SD**2, 0.0))
        given = np.isfinite(own) & (own <= KernelNoiseSettings().largest_sd)
        whole, error = (float(np.median(stated[np.isfinite(stated)])) if np.isfinite(stated).any() else None), over - 1.0
        return {
            "error_pct": round(100.0 * error, 1) if np.isfinite(error) else None,
            "stated_pct": round(100.0 * whole, 1) if whole is not None else None,
            "refused_pct": round(100.0 * (1.0 - float(given.mean()))), "verdict": verdicts[-1].name.lower(),
        }  # fmt: skip

    def _over_true(self, chain: Chain, seed: int) -> tuple[float, Array, list[KernelVerdict]]:
        made = train(
            self._pulses, chain, spacing_m=self._machine.paddle_spacing_m,
            speed_m_s=float(self._machine.paddle_speed_m_s(RPM_TOLD * RPM)), cell_s=self._cell_s,
            gain_n_per_mv=self._machine.sensor.gain_n_per_mv, end_s=END_S, seed=seed,
        )  # fmt: skip
        monitor = self._monitor()
        monitor.set_kernel_weight(1e3 * self.kernel_g)
        windows = [w for frame in traffic(made, chain, self.angle_deg, seed) for w in windows_in(monitor.feed(frame))]
        late = [w.waveform for w in windows if w.record.time_s > SETTLED_S]
        flows = np.array([w.kernels_kg_s for w in late])
        mean = float(flows[np.isfinite(flows)].mean()) if np.isfinite(flows).any() else float("nan")
        stated = np.array([w.kernels_std_dev_kg_s for w in late]) / flows
        return mean / (self.load_kg * made.strikes_per_s), stated, [w.kernels for w in late]

    def _monitor(self) -> Monitor:
        sd = {"friction": 0.02, "density": 0.02 * self._values["density"], "restitution": 0.08}
        parameters = ParameterSet(self._values, tuple(sd), np.diag([v**2 for v in sd.values()]))
        waveform = replace(
            WaveformSettings(), shape=pulse_shape_file.load(), enabled=True, kernel_bias=self.bias,
            kernel_bias_sd=BIAS_SD * self.bias, kernel_mass_sd=WEIGHT_SD,
        )  # fmt: skip
        settings = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
        estimator = OpenLoop(ForwardModel(self._machine, parameters.effects), parameters)
        # No setting of the service moves the limit.
        with mock.patch.object(kernel_channel, "KernelNoiseSettings", partial(KernelNoiseSettings, largest_sd=self._limit)):
            return Monitor(settings, self._machine, estimator)


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of rows with an error: how well what is stated carries it, and what the refusals cost."""
    given = [row for row in rows if row["error_pct"] is not None and row["refused_pct"] < 50]
    over = [row["error_pct"] / row["stated_pct"] for row in given]
    return {
        "rows": len(rows), "given": len(given), "beyond_two_deviations": sum(abs(z) > 2.0 for z in over),
        "rms_error_over_stated": round(float(np.sqrt(np.mean(np.square(over)))), 2),
        "refused": len(rows) - len(given),
        "refused_within_10_pct": sum(
            row["refused_pct"] >= 50 and row["error_pct"] is not None and abs(row["error_pct"]) < 10.0 for row in rows
        ),
    }  # fmt: skip


def report(seed: int, cell_s: float = 0.0002, groups: tuple[str, ...] = ("0.2 kg", "0.5 kg")) -> dict[str, Any]:
    """Each chain with each load; and an even one through the cells of `CELLS_S`, calibrated on the other crop."""
    pulses = heaps(FORCES, MORE_FORCES)
    rows = []
    for group in groups:
        judge = Judge(pulses, GROUPS[group], cell_s, seed, limit=np.inf)
        rows += [
            {"group": group, "chain": name, **judge.row(chain, seed + CALIBRATIONS + 1)} for name, chain in CHAINS.items()
        ]  # fmt: skip
    return {"cell_ms": 1e3 * cell_s, "summary": _summary(rows), "rows": rows, "other_crop": list(_cells(pulses, seed))}


def _cells(pulses: Heaps, seed: int) -> Iterator[dict[str, Any]]:
    for load in ("0.2 kg", "0.5 kg"):
        for cell in CELLS_S:
            for own, other in ((load, f"{load}, light"), (f"{load}, light", load)):
                found_bias = Judge(pulses, GROUPS[other], cell, seed).bias
                bias = found_bias if np.isfinite(found_bias) else WaveformSettings().kernel_bias
                judge = Judge(pulses, GROUPS[own], cell, seed, bias=bias)
                found = judge.row(Chain(), seed + CALIBRATIONS + 1)
                yield {"cell_ms": 1e3 * cell, "group": own, "calibrated_on": other, "bias": round(judge.bias, 2), **found}
