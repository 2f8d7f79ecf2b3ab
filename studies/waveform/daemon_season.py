"""Load errors of a season in which restitution and density drift by 15 %, by the channels that weigh the grain.

The virtual combine strikes with kernels, one by one, and a 1 kHz sensor behind a cell of 0.2 ms shows them. One monitor drives
the plate through its sweeps; the others hear the same frames. All begin with the one calibration of the season, with a
thousand-kernel weight and one weighed load or several, and are updated by the same sweeps; no scale weighs the tank:

(b) mean force; (e) and shape; (f) and kernel noise; (g) and a ticket after each third of the season. With a test weight in the
GrainCondition frames, which the daemon takes where `self_calibration.density_ratio` is set: (b+) and (e+). With kernels weighed
better or more often, from the calibration on: `WEIGHINGS`. Weighings at one load have one error, in units of each column's
deviation; the weighings between those of (f) have a chance of their own, so that the other columns are what they are without
them.

An hour stands for the season: 24 loads of two and a half minutes, a sweep in every second. The drift rates of the
configuration are those by which what is not known of density and restitution grows to 15 % until its end.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.frame_runs import run_of
from studies.waveform.season import bias_slope
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result, frames_in, records_in, windows_in
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict
from yieldmon.files import pulse_shape_file
from yieldmon.frames import GRAIN_KERNELS, TANK_SCALE, Frame
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

Array = NDArray[np.float64]
LOADS, LOAD_S, CALIBRATION_S, BETWEEN_S = 24, 150.0, 450.0, 5.0
SWEEP_EVERY = 2
"""Loads; the operator asks for it."""
SWEEPS = replace(SweepSettings(), interval_s=1e6, first_after_s=1e6)
DRIFT = 0.15
CELL_S = 0.0002
KERNELS_G = 350.0
WEIGHT_SD, WEIGHT_LOADS = 0.02, 8
"""Of the kernels' weight as told, and for how many loads it is told."""
TICKETS, TICKET_SD = (8, 16), 0.002
TEST_WEIGHT_SHARE, TEST_WEIGHT_SD = 0.655, 0.02
NOISE_RATIO, NOISE_LOAD_EXPONENT = 1.12, -0.07
"""Of kernels in discrete elements, at 1 kHz behind a cell of 0.2 ms (kernels.json)."""
MACHINE = replace(Machine(), sensor=replace(Machine().sensor, response_s=CELL_S))
TRUE = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
CALIBRATED_SD = {"friction": 0.006, "density": 5.5, "restitution": 0.008}
"""Of the season's one calibration: 3 % of friction, half a per cent of density and of impact gain."""
CALIBRATED_SHAPE = {
    "stretch_sd": 0.015, "model_error": 0.02, "friction_sd": 0.1, "shape_ratio_sd": 0.02, "tail_sd": 0.2,
}  # fmt: skip
"""What is known of the shape once it is calibrated on the machine."""
WEIGHINGS = {"f_1pct": (0.01, WEIGHT_LOADS), "f_often": (WEIGHT_SD, 2), "f_1pct_often": (0.01, 2)}
"""As `WEIGHT_SD` and `WEIGHT_LOADS`, of the further columns of (f)."""
NAMES = ("b", "e", "f", "g", "b+", "e+", *WEIGHINGS)


def scenario(rng: np.random.Generator, restitution: float, density: float, duration_s: float, slope: float) -> dict[str, Any]:
    """Passes of two minutes at flows of their own, after the empty machine."""
    harvest = {
        "kind": "stop-and-go", "duration_s": duration_s, "flow_kg_s": float(rng.uniform(7.0, 13.0)), "flow_variation_pct": 20.0,
        "pass_s": 134.0, "headland_s": 8.0, "unload_every": 1000,
    }  # fmt: skip
    kernels = {
        "thousand_kernel_weight_g": KERNELS_G, "noise_load_exponent": NOISE_LOAD_EXPONENT,
        "noise_ratio": NOISE_RATIO * float(np.exp(slope * (restitution - TRUE["restitution"]))),
    }  # fmt: skip
    return {
        "duration_s": duration_s, "crop": {"restitution": restitution, "bulk_density_kg_m3": density},
        "flow": {"pieces": [{"kind": "steady", "duration_s": 16.0, "flow_kg_s": 0.0}, harvest]},
        "kernels": kernels, "sensor": {"response_s": CELL_S},
    }  # fmt: skip


def _calibrator(test_weight: bool) -> CalibratorSettings:
    hours = LOADS * (LOAD_S + BETWEEN_S) / 3600.0
    gain = DRIFT * TRUE["restitution"] / (1.0 + TRUE["restitution"])
    per_root_hour = {name: size / hours**0.5 for name, size in (("friction", DRIFT), ("density", DRIFT), ("restitution", gain))}
    ratio = 1.0 / TEST_WEIGHT_SHARE if test_weight else None
    weight_sd = TEST_WEIGHT_SD * TEST_WEIGHT_SHARE * TRUE["density"]
    # As studies/season: of many sweeps each may say little.
    loop = ClosedLoopSettings(
        flow="process", flow_process_sd=0.12, flow_process_time_s=30.0, model_error=0.004, learned_information=1e-6,
        kept_ratio=1.0 - 1e-6,
    )  # fmt: skip
    return CalibratorSettings(
        loop, drift=DriftRates(per_root_hour, {}, {}), density_ratio=ratio, density_ratio_std_dev=0.01 / TEST_WEIGHT_SHARE,
        test_weight_std_dev_kg_m3=weight_sd,
    )  # fmt: skip


def _monitor(known: ParameterSet, waveform: WaveformSettings, *, drives: bool, test_weight: bool, sweeps: bool = True) -> Monitor:
    engine = replace(EngineSettings(), waveform=waveform, sweep=replace(SWEEPS, enabled=sweeps))
    model = ForwardModel(MACHINE, known.effects)
    calibrator = ClosedLoopCalibrator(model, _calibrator(test_weight)) if sweeps else None
    return Monitor(engine, MACHINE, OpenLoop(model, known), calibrator, drives_plate=drives)


@dataclass
class Strategy:
    """A monitor and what it has measured of the load."""

    monitor: Monitor
    mass_kg: float = 0.0
    windows: int = 0
    with_shape: int = 0
    with_kernels: int = 0
    error_pct: list[float] = field(default_factory=list)

    def heard(self, results: list[Result]) -> None:
        """Windows that closed."""
        for record in records_in(results):
            self.mass_kg += record.mass_kg
            self.windows += record.mass_kg > 0.0
            self.with_shape += record.shape_verdict is ShapeVerdict.USED
            self.with_kernels += record.kernel_verdict is KernelVerdict.USED

    def judged(self, true_kg: float) -> None:
        """The load is over."""
        self.error_pct.append(100.0 * (self.mass_kg / true_kg - 1.0))
        self.mass_kg = 0.0


def _frames(combine: VirtualCombine, until_s: float, later_s: float) -> Iterator[Frame]:
    """Without the kernels' weight, which is entered, and the tank's scale."""
    for frame in combine.frames_until(until_s):
        if frame.message not in (GRAIN_KERNELS, TANK_SCALE):
            yield frame._replace(time_s=frame.time_s + later_s)


def _calibrate(known: ParameterSet, told_g: float, rngs: Sequence[np.random.Generator], slope: float) -> WaveformSettings:
    """Stretch as `status` gives it over weighed loads, and the bias with which kernel noise gives their masses: their means.

    rngs: of the loads, one each.
    """
    waveform = replace(WaveformSettings(), shape=pulse_shape_file.load(), enabled=True, kernel_bias_sd=0.02, response_error=0.02,
                       kernel_mass_sd=WEIGHT_SD, kernel_windows=300, **CALIBRATED_SHAPE)  # type: ignore[arg-type]  # fmt: skip
    found = np.array([_weighed_load(known, waveform, told_g, rng, slope) for rng in rngs])
    stretch, bias = found.mean(axis=0).tolist()
    return replace(waveform, combine=True, stretch=stretch, kernel_bias=bias)


def _weighed_load(
    known: ParameterSet, waveform: WaveformSettings, told_g: float, rng: np.random.Generator, slope: float
) -> tuple[float, float]:
    """Stretch and bias of one."""
    monitor = _monitor(known, waveform, drives=False, test_weight=False, sweeps=False)
    monitor.set_kernel_weight(told_g)
    ground = scenario(rng, TRUE["restitution"], TRUE["density"], CALIBRATION_S, slope)
    combine = VirtualCombine(from_mapping(ground, "calibration"), MACHINE, seed=int(rng.integers(1 << 30)))
    measured, stretches, biases = 0.0, [], []
    for frame in _frames(combine, CALIBRATION_S, 0.0):
        for window in windows_in(monitor.feed(frame)):
            measured += window.record.mass_kg
            stretches.append(window.waveform.stretch)
            biases.append(window.waveform.bias)
    weighed = float(combine.truth.columns["mass_flow_kg_s"].sum()) * (1.0 + TICKET_SD * rng.standard_normal())
    # `status` gives the bias that agrees with the mean force, whose own mass of the load is another.
    return float(np.nanmedian(stretches)), float(np.nanmedian(biases[-100:])) * weighed / measured


def _weigh(strategies: dict[str, Strategy], load: int, off: float) -> None:
    """Tells those of `WEIGHINGS` whose kernels are weighed at this load a weight that is so many of its deviations off."""
    for name, strategy in strategies.items():
        sd, loads = WEIGHINGS[name]
        if load % loads == 0:
            strategy.monitor.set_kernel_weight(KERNELS_G * (1.0 + sd * off))


def season(seed: int, slope: float, names: tuple[str, ...] = NAMES, weighed_loads: int = 1) -> dict[str, Any]:
    """Errors of the loads, %, by strategy, of which (f) is always there.

    slope: d ln(b) / d restitution. weighed_loads: from which the channels are calibrated; the first one's chances, and the
    season's, are the same for any number.
    """
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=2)
    learned = tuple(CALIBRATED_SD)
    drawn = {name: TRUE[name] + sd * float(rng.standard_normal()) for name, sd in CALIBRATED_SD.items()}
    known = ParameterSet({**TRUE, **drawn}, learned, np.diag([CALIBRATED_SD[name] ** 2 for name in learned]))
    off = float(rng.standard_normal())
    told_g = KERNELS_G * (1.0 + WEIGHT_SD * off)
    further = [np.random.default_rng([seed, 2, number]) for number in range(1, weighed_loads)]
    waveform = _calibrate(known, told_g, [rng, *further], slope)
    plain = replace(waveform, enabled=False, combine=False)
    driver = Strategy(_monitor(known, waveform, drives=True, test_weight=False))
    listeners = {
        "b": Strategy(_monitor(known, plain, drives=False, test_weight=False)),
        "e": Strategy(_monitor(known, waveform, drives=False, test_weight=False)),
        "g": Strategy(_monitor(known, waveform, drives=False, test_weight=False)),
        "b+": Strategy(_monitor(known, plain, drives=False, test_weight=True)),
        "e+": Strategy(_monitor(known, waveform, drives=False, test_weight=True)),
    }
    for name, (sd, _) in WEIGHINGS.items():
        # Kernel flow is bias times weight, so the bias that gives the weighed load goes as one over the weight it was found with.
        bias = waveform.kernel_bias * told_g / (KERNELS_G * (1.0 + sd * off))
        settings = replace(waveform, kernel_bias=bias, kernel_mass_sd=sd)
        listeners[name] = Strategy(_monitor(known, settings, drives=False, test_weight=False))
    listeners = {name: strategy for name, strategy in listeners.items() if name in names}
    every = {"f": driver, **listeners}
    told = sorted({"f", "g"} & set(every))
    more = np.random.default_rng([seed, 1])
    for n in range(LOADS):
        restitution, density = (
            TRUE[name] * (1.0 + DRIFT * sign * n / (LOADS - 1))
            for name, sign in zip(("restitution", "density"), signs, strict=True)
        )
        if n and n % WEIGHT_LOADS == 0:
            off = float(rng.standard_normal())
            told_g = KERNELS_G * (1.0 + WEIGHT_SD * off)
        for name in told:
            every[name].monitor.set_kernel_weight(told_g)
        between = float(more.standard_normal())
        _weigh({name: every[name] for name in WEIGHINGS if name in every}, n, off if n % WEIGHT_LOADS == 0 else between)
        ground = scenario(rng, restitution, density, LOAD_S, slope)
        combine = VirtualCombine(from_mapping(ground, "season"), MACHINE, seed=int(rng.integers(1 << 30)))
        later_s = 10.0 + n * (LOAD_S + BETWEEN_S)
        if "g" in every:
            every["g"].monitor.start_load()
        if n % SWEEP_EVERY == 0:
            driver.monitor.request_sweep()
        frames = []
        for frame in _frames(combine, LOAD_S, later_s):
            frames.append(frame)
            results = driver.monitor.feed(frame)
            driver.heard(results)
            for answer in frames_in(results):
                combine.handle(answer._replace(time_s=answer.time_s - later_s))
        run = run_of(frames)
        for listener in listeners.values():
            listener.heard(listener.monitor.feed_run(run, reports=False))
        true_kg = float(combine.truth.columns["mass_flow_kg_s"].sum())
        for strategy in every.values():
            strategy.judged(true_kg)
        if n in TICKETS and "g" in every:
            monitor = every["g"].monitor
            assert monitor.open_load is not None
            weighed = true_kg * (1.0 + TICKET_SD * rng.standard_normal())
            monitor.ticket(monitor.open_load.number, weighed, TICKET_SD * true_kg)
    return {
        "seed": seed, "signs": signs.tolist(), "kernel_bias": round(waveform.kernel_bias, 3),
        "stretch": round(waveform.stretch, 3), "sweeps": driver.monitor.sweep.sweep_id,
        "updates": driver.monitor.estimator.parameters.version - known.version,
        "last_update": driver.monitor.outcome.reason if driver.monitor.outcome else str(driver.monitor.sweep.abort_reason),
        "with_shape_pct": round(100.0 * driver.with_shape / driver.windows),
        "with_kernels_pct": round(100.0 * driver.with_kernels / driver.windows),
        **{f"{name}_mean_abs_pct": round(float(np.mean(np.abs(every[name].error_pct))), 2) for name in every},
        **{f"{name}_pct": np.round(strategy.error_pct, 2).tolist() for name, strategy in every.items()},
    }  # fmt: skip


def best_possible(exponent: float) -> dict[str, float]:
    """What (e) could reach at best: mean absolute error of the season over that of (b), in the mean of the four ways to drift.

    The shape is taken as without error and friction as known. exponent: d ln(force) / d ln(flow), n. The mean force's flow is off
    by (gain + (1 - n) density) / n, the shape's by -density; a fixed share of each is taken, the one that is least wrong over all
    four ways.
    """
    gain = DRIFT * TRUE["restitution"] / (1.0 + TRUE["restitution"])
    ways = [(first * gain, second * DRIFT) for first in (-1.0, 1.0) for second in (-1.0, 1.0)]

    def mean(share: float) -> float:
        errors = [(1.0 - share) * (g + (1.0 - exponent) * d) / exponent - share * d for g, d in ways]
        return float(np.mean(np.abs(errors)))

    shares = np.linspace(0.0, 1.0, 1001)
    found = [mean(share) for share in shares]
    return {"exponent": exponent, "least_over_b": round(min(found) / found[0], 3), "share": float(shares[int(np.argmin(found))])}


def report(
    seeds: int,
    first: int,
    before: dict[str, Any] | None = None,
    slope: float | None = None,
    names: tuple[str, ...] = NAMES,
    weighed_loads: int = 1,
) -> Iterator[dict[str, Any]]:
    """The document so far after each season, the last one whole.

    before: one that was not finished; its seasons stand. slope: d ln(b) / d restitution, by default that of discrete elements.
    names: strategies, (f) among them. weighed_loads: as of `season`.
    """
    slope = round(bias_slope() if slope is None else slope, 3)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows = [{"commit": before["commit"], **row} for row in before["seasons"]] if before is not None else []
    done = {row["seed"] for row in rows}
    for seed in range(first, first + seeds):
        if seed in done:
            continue
        rows.append({"commit": commit, **season(seed, slope, names, weighed_loads)})
        errors = {name: np.array([row[f"{name}_mean_abs_pct"] for row in rows]) for name in names}
        alike = np.array([row["signs"][0] == row["signs"][1] for row in rows])
        yield {
            "commit": commit, "loads": LOADS, "load_s": LOAD_S, "bias_slope": slope, "weighed_loads": weighed_loads,
            "mean": {name: round(float(e.mean()), 2) for name, e in errors.items()},
            "largest": {name: round(float(e.max()), 2) for name, e in errors.items()},
            "alike": {name: round(float(e[alike].mean()), 2) for name, e in errors.items()} if alike.any() else None,
            "against": {name: round(float(e[~alike].mean()), 2) for name, e in errors.items()} if not alike.all() else None,
            "seasons_alike": int(alike.sum()),
            "halved": {
                name: int((errors[name] <= 0.5 * errors[of]).sum())
                for name, of in (("e", "b"), ("e+", "b+"))
                if name in errors and of in errors
            },
            "below_2_pct": {name: int((e < 2.0).sum()) for name, e in errors.items()},
            "best_possible": [best_possible(n) for n in (0.7, 0.75, 0.8)],
            "seasons": rows,
        }  # fmt: skip
