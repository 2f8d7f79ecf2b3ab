"""Whether the published standard deviations of flow and load mass hold: z over scenarios of the virtual combine.

    python -m studies.coverage                            # all scenarios; table here as results.json
    python -m studies.coverage --machines 4               # quicker
    python -m studies.coverage --only slip lively --out F
    python -m studies.coverage --fixed                    # sizes fixed, the shipped parameters as they are
    python -m studies.coverage --causes --only clean      # what loads' stated deviations and errors are made of

z = (published - true) / published standard deviation. Flow: every second from 4 kg/s. Load: every load of a minute. An error that
all seconds of a run share is one draw, however long the run: so every run is a machine of its own, whose parameters are the
shipped ones with an error drawn from their covariance, and whose effect has a size drawn from a distribution; a seed
draws another machine in each scenario, so that those of all scenarios are as many draws. Rows "after" count
from the first whole sweep (sweeps) or the first ticket (slip, ticketed) on: what nothing has shown yet, no budget can hold.
Rows "load_posted" are all loads as they are stated at the end of the run, when sweeps and tickets have shown what they show,
"total" their total mass. Behind sd stands the range in which 90 % of it lie when the machines are drawn again: what few machines
leave open. Rows "together" are of all scenarios of the command; in its rows "flow_known" and "load_known" slip counts from its
ticket on, which is the first to show it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import events_in, frames_in, records_in
from yieldmon.engine.sweeps.plate import SweepEnded
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import SweepState
from yieldmon.physics.machine import RPM
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.effects import ChainSlip, Effects, MoistureDependence, PlateFriction
from yieldmon.plant.profiles import FlowProfile, Oscillating, Steady
from yieldmon.plant.scenario import Scenario, ScenarioCrop
from yieldmon.plant.sensor import SensorSettings
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration

FOLDER = Path(__file__).resolve().parent
FIRST_SEED = 41000
EMPTY_S = 8.0
LOAD_S = 60.0
LEAST_KG_S = 4.0
LINE = (
    "{scenario:>10} {of:>11}: {count} z of {machines}, mean {mean:+.2f}, sd {sd:.2f} ({sd_range[0]:.2f} to {sd_range[1]:.2f}), "
    "rms {rms:.2f}, {within_1:.0%} / {within_2:.0%}"
)
SETTLING_S = 15.0
"""Of harvest, before the first second that counts."""


@dataclass(frozen=True)
class Sizes:
    """What differs from the ordinary harvest in one run. sweep_every_s: 0 for none; weighs: the first load gets its ticket."""

    plate_friction: float = 0.0
    slip: float = 0.0
    moisture: MoistureDependence | None = None
    scatter_pct: float = 7.0
    noise_mv: float = SensorSettings().noise_mv
    variation_pct: float = 1.5
    variation_time_s: float = 20.0
    moisture_pct: float = 15.0
    end_moisture_pct: float | None = None
    moisture_measured: bool = True
    swings: bool = True
    sweep_every_s: float = 0.0
    weighs: bool = False

    @property
    def effects(self) -> Effects:
        """Of the combine."""
        own: dict[str, Any] = {"moisture_dependence": self.moisture}
        if self.plate_friction:
            own["plate_friction"] = PlateFriction(friction=self.plate_friction)
        if self.slip:
            own["chain_slip"] = ChainSlip(share=self.slip)
        return Effects().model_copy(update=own)


def _slopes(rng: np.random.Generator) -> MoistureDependence:
    """Of a variety: published slopes of friction, restitution and density (config/crops.yaml), spread by half."""
    friction, restitution, density = rng.normal((0.030, -0.020, -0.007), (0.012, 0.008, 0.004))
    return MoistureDependence(
        friction_per_pct=float(np.clip(friction, -0.2, 0.2)),
        restitution_per_pct=float(np.clip(restitution, -0.1, 0.1)),
        density_per_pct=float(np.clip(density, -0.05, 0.05)),
    )


def _dried(rng: np.random.Generator) -> Sizes:
    slopes = _slopes(rng)
    return Sizes(moisture=slopes, end_moisture_pct=float(rng.uniform(8.0, 22.0)))


def _unmeasured(rng: np.random.Generator) -> Sizes:
    slopes = _slopes(rng)
    return Sizes(moisture=slopes, moisture_pct=float(np.clip(rng.normal(15.0, 2.0), 6.0, 24.0)), moisture_measured=False)


def _friction(rng: np.random.Generator) -> float:
    """Of grain on the plate: half normal, 0.15 in the rms, as large as the fixed one."""
    return float(min(abs(rng.normal(0.0, 0.15)), 0.6))


@dataclass(frozen=True)
class Case:
    """A scenario: sizes of one run, drawn; and the sizes as they are fixed."""

    name: str
    drawn: Callable[[np.random.Generator], Sizes]
    fixed: Sizes


CASES = (
    Case("ordinary", lambda rng: Sizes(), Sizes()),
    Case("scatter", lambda rng: Sizes(scatter_pct=float(rng.uniform(8.0, 16.0))), Sizes(scatter_pct=12.0)),
    Case(
        "lively",
        lambda rng: Sizes(variation_pct=float(rng.uniform(5.0, 11.0)), variation_time_s=float(rng.uniform(4.0, 9.0))),
        Sizes(variation_pct=8.0, variation_time_s=6.0),
    ),
    Case("moisture", _dried, Sizes(moisture=MoistureDependence(), end_moisture_pct=22.0)),
    Case("unmeasured", _unmeasured, Sizes(moisture=MoistureDependence(), moisture_pct=17.0, moisture_measured=False)),
    Case(
        "sweeps",
        lambda rng: Sizes(plate_friction=_friction(rng), sweep_every_s=90.0),
        Sizes(plate_friction=0.15, sweep_every_s=90.0),
    ),
    Case(
        "steady",
        lambda rng: Sizes(plate_friction=_friction(rng), sweep_every_s=30.0, swings=False),
        Sizes(plate_friction=0.15, sweep_every_s=30.0, swings=False),
    ),
    Case(
        "clean",
        lambda rng: Sizes(sweep_every_s=30.0, swings=False),
        Sizes(sweep_every_s=30.0, swings=False),
    ),
    Case(
        "ticketed",
        lambda rng: Sizes(plate_friction=_friction(rng), sweep_every_s=90.0, weighs=True),
        Sizes(plate_friction=0.15, sweep_every_s=90.0, weighs=True),
    ),
    Case("slip", lambda rng: Sizes(slip=float(rng.uniform(0.03, 0.09)), weighs=True), Sizes(slip=0.06, weighs=True)),
)


@dataclass(frozen=True)
class Found:
    """z of seconds and loads of one run, all and those after the first whole sweep or ticket, and whether the alarm of scale was
    shown after the first ticket. load_posted: of the loads as they are stated at the end of the run; total: of all mass."""

    flow: NDArray[np.float64]
    load: NDArray[np.float64]
    flow_after: NDArray[np.float64]
    load_after: NDArray[np.float64]
    load_posted: NDArray[np.float64]
    total: NDArray[np.float64]
    alarm: bool


def scenario_of(sizes: Sizes, duration_s: float) -> Scenario:
    """The harvest: steady at 10 kg/s, then swinging about 12 kg/s by 3 in 60 s, or steady at 11 kg/s."""
    pieces: list[Any] = [Steady(kind="steady", duration_s=EMPTY_S, flow_kg_s=0.0)]
    if sizes.swings:
        pieces += [
            Steady(kind="steady", duration_s=60.0, flow_kg_s=10.0),
            Oscillating(kind="oscillating", duration_s=duration_s, mean_kg_s=12.0, amplitude_kg_s=3.0, period_s=60.0),
        ]
    else:
        pieces += [Steady(kind="steady", duration_s=duration_s, flow_kg_s=11.0)]
    flow = FlowProfile(pieces=pieces, variation_pct=sizes.variation_pct, variation_time_s=sizes.variation_time_s, smoothing_s=0.7)
    crop = ScenarioCrop(moisture_pct=sizes.moisture_pct, end_moisture_pct=sizes.end_moisture_pct)
    return Scenario(
        duration_s=duration_s, crop=crop, effects=sizes.effects, flow=flow, paddle_scatter_pct=sizes.scatter_pct,
        sensor=SensorSettings(noise_mv=sizes.noise_mv),
    )  # fmt: skip


def parameters_of(shipped_set: ParameterSet, rng: np.random.Generator) -> ParameterSet:
    """A machine's: the shipped set, which was fitted to this combine, with an error drawn from the covariance that it states."""
    names = shipped_set.covariance_names
    error = rng.multivariate_normal(np.zeros(len(names)), shipped_set.covariance)
    moved = {name: shipped_set.values[name] + float(by) for name, by in zip(names, error, strict=True)}
    return replace(shipped_set, values={**shipped_set.values, **moved})


@dataclass(frozen=True)
class Load:
    """Of one run. first, last: of its records. true_kg: that struck the plate meanwhile. closed: as it was stated at its end."""

    first: int
    last: int
    end_s: float
    true_kg: float
    closed: LoadSummary


@dataclass(frozen=True)
class Harvest:
    """A run: records, loads by number as they closed and as they are stated at its end, all mass and its standard deviation, kg,
    the combine, when the first whole sweep or the ticket came (inf: never), and whether the alarm of scale was shown."""

    records: list[WindowRecord]
    loads: dict[int, Load]
    posted: dict[int, LoadSummary]
    total: tuple[float, float]
    combine: VirtualCombine
    delay_s: float
    known_s: float
    alarm: bool


def harvest(loaded: configuration.Configuration, parameters: ParameterSet, sizes: Sizes, duration_s: float, seed: int) -> Harvest:
    """One run of a machine with the shipped configuration."""
    every_s = sizes.sweep_every_s
    sweep = replace(loaded.engine.sweep, enabled=every_s > 0.0, first_after_s=every_s or 600.0, interval_s=every_s or 1800.0)
    monitor = build_monitor(replace(loaded.engine, sweep=sweep), loaded.machine, parameters, loaded.calibrator)
    scenario = scenario_of(sizes, duration_s)
    combine = VirtualCombine(scenario, loaded.machine, seed)
    records: list[WindowRecord] = []
    ends = np.arange(EMPTY_S - 1.0, duration_s, LOAD_S)
    loads: dict[int, Load] = {}
    delay_s = 0.5 * loaded.machine.pattern_length_m / loaded.machine.paddle_speed_m_s(scenario.elevator.speed_rpm * RPM)
    alarm, known_s = False, np.inf
    for number, end_s in enumerate((*ends.tolist(), duration_s)):
        for frame in combine.frames_until(end_s):
            if frame.message == bus.GRAIN_CONDITION and not sizes.moisture_measured:
                continue
            found = monitor.feed(frame)
            for answer in frames_in(found):
                combine.handle(answer)
            records += records_in(found)
            ended = [e for e in events_in(found) if isinstance(e, SweepEnded) and e.state is not SweepState.ABORTED]
            known_s = min(known_s, frame.time_s) if ended else known_s
        load, alarm = monitor.open_load, alarm or monitor.faults.is_active(FaultCode.SCALE_DISAGREES)
        if number and load is not None and load.measured_kg > 100.0:
            first = len(records) - round(LOAD_S)
            times = np.array([records[first].time_s - 1.0, records[-1].time_s]) - delay_s
            if end_s - times[0] < LOAD_S + 2.0 and number <= ends.size - 1:
                true_kg = float(np.diff(combine.delivered_kg(times))[0])
                # A load that was open when it became known is reported as well.
                loads[load.number] = Load(first, len(records), end_s, true_kg, load)
                if sizes.weighs and number == 1:
                    monitor.ticket(load.number, true_kg, 0.002 * true_kg)
                    known_s = end_s + 1.0
        monitor.start_load()
    posted = {load.number: load for load in monitor.loads}
    total = monitor.totals.total_kg, monitor.totals.total_budget.std_dev_kg
    return Harvest(records, loads, posted, total, combine, delay_s, known_s, alarm)


def drawn(case: Case, loaded: configuration.Configuration, seed: int, *, fixed: bool = False) -> tuple[Sizes, ParameterSet]:
    """What the machine of a seed does, and its parameters. fixed: the shipped ones and the case's fixed sizes."""
    rng = np.random.default_rng((seed, 16, crc32(case.name.encode())))
    if fixed:
        return case.fixed, loaded.parameters
    sizes = case.drawn(rng)
    return sizes, parameters_of(loaded.parameters, rng)


def one(case: Case, duration_s: float, seed: int, *, fixed: bool) -> Found:
    """One run with the shipped configuration. fixed: as in `drawn`."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    sizes, parameters = drawn(case, loaded, seed, fixed=fixed)
    run = harvest(loaded, parameters, sizes, duration_s, seed)
    time_s = np.array([r.time_s for r in run.records])
    true = run.combine.delivered_kg(time_s - run.delay_s) - run.combine.delivered_kg(np.maximum(time_s - run.delay_s - 1.0, 0.0))
    flow, sd = (np.array([getattr(r, name) for r in run.records]) for name in ("mass_flow_kg_s", "std_dev_kg_s"))
    counts = (true >= LEAST_KG_S) & np.isfinite(flow) & (time_s > EMPTY_S + SETTLING_S)
    z = (flow - true) / sd
    load_z = np.array([(load.closed.measured_kg - load.true_kg) / load.closed.std_dev_kg for load in run.loads.values()])
    after = np.array([load.end_s > run.known_s for load in run.loads.values()], dtype=bool)
    posted = [(k.measured_kg - run.loads[n].true_kg) / k.std_dev_kg for n, k in run.posted.items() if n in run.loads]
    (true_kg,) = run.combine.delivered_kg(time_s[-1:] - run.delay_s)
    total = np.array([(run.total[0] - true_kg) / run.total[1]])
    return Found(z[counts], load_z, z[counts & (time_s > run.known_s)], load_z[after], np.array(posted), total, run.alarm)


def sd_range(runs: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """Range of 90 % of the standard deviation: machines drawn again, with all their values (bootstrap)."""
    rng, runs = np.random.default_rng(0), [run for run in runs if run.size]
    found = [float(np.concatenate([runs[k] for k in rng.integers(len(runs), size=len(runs))]).std()) for _ in range(400)]
    low, high = np.percentile(found, [5.0, 95.0])
    return float(low), float(high)


def row(name: str, runs: list[NDArray[np.float64]]) -> dict[str, Any]:
    """Mean, standard deviation about 0 and about the mean, and shares within one and two."""
    values = np.concatenate(runs)
    return {
        "of": name, "machines": sum(run.size > 0 for run in runs), "count": int(values.size),
        "mean": round(float(values.mean()), 2), "sd": round(float(values.std()), 2),
        "sd_range": [round(end, 2) for end in sd_range(runs)],
        "rms": round(float(np.sqrt(np.mean(values**2))), 2),
        "within_1": round(float(np.mean(np.abs(values) <= 1.0)), 3), "within_2": round(float(np.mean(np.abs(values) <= 2.0)), 3),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed (default: %(default)s)")
    parser.add_argument("--machines", type=int, default=24, help="runs of each scenario (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=190.0, help="of a run, s (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=[case.name for case in CASES], default=[case.name for case in CASES])
    parser.add_argument("--fixed", action="store_true", help="sizes fixed and the shipped parameters, in place of machines drawn")
    parser.add_argument("--causes", action="store_true", help="errors and stated deviations of loads, as they closed, by cause")
    parser.add_argument("--out", type=Path, default=FOLDER / "results.json")
    args = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows: list[dict[str, Any]] = []
    together: dict[str, list[NDArray[np.float64]]] = {}
    if args.causes:
        from studies.coverage.causes import table

        for case in (case for case in CASES if case.name in args.only):
            print(table(case, args.duration, range(args.first, args.first + args.machines)), flush=True)
        return 0
    for case in (case for case in CASES if case.name in args.only):
        runs = [one(case, args.duration, args.first + k, fixed=args.fixed) for k in range(args.machines)]
        for what in ("flow", "load", "flow_after", "load_after", "load_posted", "total"):
            values = [getattr(run, what) for run in runs]
            if any(part.size for part in values):
                rows.append({"scenario": case.name, **row(what, values)})
                print(LINE.format(**rows[-1]), flush=True)
                together[what] = [*together.get(what, []), *values]
        for what in ("flow", "load"):
            shown = [getattr(run, f"{what}_after" if case.fixed.slip else what) for run in runs]
            together[f"{what}_known"] = [*together.get(f"{what}_known", []), *shown]
        if case.fixed.weighs:
            rows[-1]["alarm"] = [run.alarm for run in runs]
            print(f"{case.name:>10} alarm after the first ticket: {sum(run.alarm for run in runs)} of {len(runs)}", flush=True)
    for what in ("flow", "flow_known", "load", "load_known", "load_posted", "total") if len(args.only) > 1 else ():
        rows.append({"scenario": "together", **row(what, together[what])})
        print(LINE.format(**rows[-1]), flush=True)
    found = {"commit": commit, "first_seed": args.first, "machines": args.machines, "duration_s": args.duration}
    args.out.write_text(json.dumps({**found, "fixed": args.fixed, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
