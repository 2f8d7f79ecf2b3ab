"""A season under several ways of keeping the calibration: load error and 1 Hz error, table and picture.

    python -m studies.season                                  # 60 h, seed 20261121; season.json and season.png here
    python -m studies.season --hours 12 --out /tmp/season     # shorter, elsewhere
    python -m studies.season --combines all --seeds 3         # with and without sweeps on five combines; combines.json
    python -m studies.season --combines "plate friction" --reversed --hours 12

Windows of one second from the virtual combine: moisture 14 to 26 to 16 %, friction, restitution and paddle wear drifting, flow
2-22 kg/s, loads of 4-9 t. Runs on two processes; `--json` prints the document.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.season.study import Outcome

FOLDER = Path(__file__).resolve().parent
SEED = 20261121


def one(job: tuple[int, float, int, float]):  # type: ignore[no-untyped-def]
    """One strategy by its index, season of `hours`, `seed` and drift exponent."""
    from studies.season import season as seasons
    from studies.season import study
    from yieldmon.physics.machine import Machine
    from yieldmon.plant.scenario import Scenario

    index, hours, seed, exponent = job
    settings = seasons.SeasonSettings(hours=hours, drift_exponent=exponent)
    machine = Machine()
    # The season applies its own moisture dependence; the scenario's would count it twice.
    scenario = study.scenario_of(settings).model_copy(update={"effects": Scenario().effects})
    season = seasons.simulate(settings, machine, scenario, seed)
    first = study.first_calibration(settings, machine, seed)
    return study.run(season, first, study.STRATEGIES[index], study.StudySettings())


REVERSED: dict[str, Any] = {
    "moisture_pct": (24.0, 14.0, 22.0),
    "friction_drift": -0.15,
    "restitution_drift": 0.08,
    "wear_mm": 0.0,
}
"""A season that drifts the other way: what errors cancel in one direction add up in the other."""


def compare(job: tuple[str, float, int, bool, float | None], *, without_tickets: bool = True) -> dict[str, Any]:
    """A season of one combine at the daemon's defaults, without and with sweeps, without and with a ticket a day.

    job: name, hours, seed, whether reversed, the pattern's size where it is not the daemon's. without_tickets: False leaves out
    the two strategies that never weigh a load.
    """
    from dataclasses import replace

    from studies.season import season as seasons
    from studies.season import study
    from studies.season.combines import five
    from yieldmon.estimation.admission import LARGEST_MODEL_ERROR, STOP_GAP
    from yieldmon.physics.machine import Machine

    name, hours, seed, is_reversed, pattern_sd = job
    combine, machine = five()[name], Machine()
    settings = replace(seasons.SeasonSettings(hours=hours), **(REVERSED if is_reversed else {}))
    # The season applies its own moisture dependence; the scenario's would count it twice.
    scenario = combine.scenario(study.scenario_of(settings)).model_copy(update={"effects": combine.effects})
    season = seasons.simulate(settings, machine, scenario, seed, ratio=combine.ratio)
    first = study.first_calibration(settings, machine, seed, combine)
    kept = study.StudySettings.of_daemon()
    if pattern_sd is not None:
        kept = replace(kept, pattern_sd=pattern_sd)
    found: dict[str, Any] = {"combine": name, "reversed": is_reversed, "seed": seed, "loads": len(season.loads.mass_kg)}
    found |= {"model_error": round(first.own_error, 4), "stop_gap": STOP_GAP in first.effects}
    # What no ticket takes away: then no sweep begins by schedule, and the season is the one without sweeps.
    never = first.own_error > LARGEST_MODEL_ERROR or STOP_GAP in first.effects
    outcomes: dict[int, study.Outcome] = {}
    strategies = [("map", False, 0), ("sweeps", True, 0), ("map_ticket", False, 1), ("sweeps_ticket", True, 1)]
    for label, sweeps, tickets in strategies if without_tickets else strategies[2:]:
        strategy = study.Strategy(label, moisture_map=True, sweeps=sweeps, tickets_per_day=tickets)
        outcome = outcomes[tickets] if sweeps and never else study.run(season, first, strategy, kept)
        outcomes[tickets] = outcome
        found[f"{label}_mean_abs_pct"] = round(outcome.mean_abs_load_error_pct, 3)
        found[f"{label}_live_within_1_pct"] = round(outcome.loads_within_1_pct, 3)
        found[f"{label}_posted_within_1_pct"] = round(outcome.posted_within_1_pct, 3)
        found[f"{label}_posted_mean_abs_pct"] = round(float(abs(outcome.posted_error_pct).mean()), 3)
        found[f"{label}_sweeps"], found[f"{label}_updates"] = outcome.sweeps, outcome.updates
    return found


def combines(args: argparse.Namespace) -> int:
    """The table of `--combines`; 1 where sweeps made a season worse."""
    from studies.season.combines import five

    names = list(five()) if args.combines == ["all"] else args.combines
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows = []
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / ("combines-reversed.json" if args.reversed else "combines.json")
    for seed in range(args.seed, args.seed + args.seeds):
        for name in names:
            job = (name, args.hours, seed, args.reversed, args.pattern_sd)
            rows.append(compare(job, without_tickets=not args.tickets))
            print(json.dumps(rows[-1]), flush=True)
            found = {"hours": args.hours, "commit": commit, "pattern_sd": args.pattern_sd, "seasons": rows}
            path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    kind = "_ticket" if args.tickets else ""
    return int(any(row[f"sweeps{kind}_mean_abs_pct"] > row[f"map{kind}_mean_abs_pct"] for row in rows))


def print_each(args: argparse.Namespace, look: Callable[..., dict[str, Any]]) -> int:
    """Print a line for each season of the combine as modelled.

    look: what to find of a season, its first calibration, its settings and the daemon's.
    """
    from studies.season import season as seasons
    from studies.season import study
    from yieldmon.physics.machine import Machine
    from yieldmon.plant.scenario import Scenario

    settings, machine = seasons.SeasonSettings(hours=args.hours), Machine()
    scenario = study.scenario_of(settings).model_copy(update={"effects": Scenario().effects})
    for seed in range(args.seed, args.seed + args.seeds):
        season = seasons.simulate(settings, machine, scenario, seed)
        first = study.first_calibration(settings, machine, seed)
        found = look(season, first, settings, study.StudySettings.of_daemon())
        print(json.dumps({"seed": seed, "loads": len(season.loads.mass_kg)} | found), flush=True)
    return 0


def bounds(args: argparse.Namespace) -> int:
    """A line for each season of the combine as modelled: what the best estimator could have right live."""
    from studies.season.best_live import best_live

    return print_each(args, best_live)


def home_flows(args: argparse.Namespace) -> int:
    """A line for each season: its loads under many laws of drift, with sweeps that may move the flow at home and that may not."""
    from studies.season.home_flow import home_flow

    return print_each(args, partial(home_flow, seasons=args.home_flow, common_error=args.common_error))


def causes(args: argparse.Namespace) -> int:
    """A line for each season of a combine whose grain is the model's: what its live error with a ticket a day is made of."""
    from studies.season import season as seasons
    from studies.season import study
    from studies.season.combines import AS_MODELLED, five
    from studies.season.live_causes import live_causes, live_parts
    from studies.season.sweep_readings import sweep_readings
    from yieldmon.physics.machine import Machine

    settings, machine, combine = seasons.SeasonSettings(hours=args.hours), Machine(), five()[args.live_causes]
    scenario = combine.scenario(study.scenario_of(settings)).model_copy(update={"effects": combine.effects})
    for seed in range(args.seed, args.seed + args.seeds):
        season = seasons.simulate(settings, machine, scenario, seed, ratio=combine.ratio)
        first = study.first_calibration(settings, machine, seed, combine)
        kept = study.StudySettings.of_daemon()
        found: dict[str, Any] = {"readings": sweep_readings(season, combine.shape_ratio, kept)}
        if combine is AS_MODELLED:
            found |= {"tickets": live_parts(season, first, kept), "sweeps": live_parts(season, first, kept, sweeps=True)}
        found |= live_causes(season, first, kept)
        print(json.dumps({"combine": combine.name, "seed": seed, "loads": len(season.loads.mass_kg)} | found), flush=True)
    return 0


def document(outcomes: Sequence[Outcome], hours: float, seed: int, took_s: float) -> dict[str, Any]:
    """The table as plain values."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows = [
        {
            "strategy": o.strategy.name,
            "loads": len(o.load_error_pct),
            "mean_abs_load_error_pct": round(o.mean_abs_load_error_pct, 3),
            "loads_within_1_pct": round(o.loads_within_1_pct, 3),
            "posted_within_1_pct": round(o.posted_within_1_pct, 3),
            "by_thirds": [round(share, 2) for share in o.within_1_pct_by_third],
            "flow_mean_abs_pct": round(o.window_mean_abs_pct, 3),
            "flow_p95_abs_pct": round(o.window_p95_abs_pct, 3),
            "sweeps": o.sweeps,
            "updates": o.updates,
        }
        for o in outcomes
    ]
    return {"hours": hours, "seed": seed, "commit": commit, "took_s": round(took_s, 1), "strategies": rows}


def draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Load error over the season, and what each strategy believed of friction and restitution."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    loads, friction, restitution = figure.subplots(3, 1, height_ratios=(2, 1, 1))
    for outcome in outcomes:
        loads.plot(outcome.load_error_pct, lw=1.2, label=outcome.strategy.name)
        hours = outcome.history["time_h"]
        for axes, name in ((friction, "friction"), (restitution, "restitution")):
            (line,) = axes.plot(hours, outcome.history[name], drawstyle="steps-post", lw=1.0)
            sd = outcome.history[f"{name}_sd"]
            low, high = outcome.history[name] - 1.645 * sd, outcome.history[name] + 1.645 * sd
            axes.fill_between(hours, low, high, step="post", color=line.get_color(), alpha=0.1, lw=0)
            axes.set_ylabel(f"{name} at the\nreference moisture")
    loads.axhspan(-1.0, 1.0, color="tab:green", alpha=0.15, lw=0)
    loads.set_ylabel("error of the load, %")
    loads.set_xlabel("load")
    loads.legend(loc="lower left")
    restitution.set_xlabel("hours harvested (bands: 90 %)")
    for axes in (loads, friction, restitution):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def posted_by_daemon(args: argparse.Namespace) -> int:
    """A line for each seed, and the table of all in posted.json."""
    from studies.season.posted import compare

    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows = []
    for seed in range(args.seed, args.seed + args.posted_by_daemon):
        rows.append(compare(args.hours, seed, args.drift_exponent))
        print(json.dumps(rows[-1]), flush=True)
    found = {"hours": args.hours, "drift_exponent": args.drift_exponent, "commit": commit, "seasons": rows}
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "posted.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0


def main() -> int:
    from rich.console import Console
    from rich.table import Table

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=60.0, help="of harvest (default: 60)")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--drift-exponent", type=float, default=1.0, help="power of the season's progress (default: 1, steady)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for season.json and season.png")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--posted-by-daemon",
        type=int,
        metavar="N",
        help="strategy (c) alone, kept and posted by the daemon's own code, for N seeds from --seed on; posted.json",
    )
    parser.add_argument("--combines", nargs="+", metavar="NAME", help='map and sweeps compared on these combines; "all": five')
    parser.add_argument(
        "--seeds", type=int, default=1, help="with --combines, --best-live, --live-causes and --home-flow: seasons of each"
    )
    parser.add_argument("--tickets", action="store_true", help="with --combines: only the two strategies with a ticket a day")
    parser.add_argument("--best-live", action="store_true", help="the most that any estimator could have right live")
    parser.add_argument(
        "--home-flow", type=int, metavar="N", help="whether sweeps may move the flow at home: N seasons of each drift"
    )
    parser.add_argument("--common-error", type=float, default=0.0, help="with --home-flow: of the model at 40 deg, in all sweeps")
    parser.add_argument(
        "--live-causes", choices=["as modelled", "h_f 3"], metavar="NAME", help="what the live error of this combine is made of"
    )
    parser.add_argument("--reversed", action="store_true", help="with --combines: everything drifts the other way")
    parser.add_argument(
        "--pattern-sd", type=float, help="with --combines: `self_calibration.pattern_sd` instead of the daemon's default"
    )
    args = parser.parse_args()
    others = (
        (args.posted_by_daemon is not None, posted_by_daemon),
        (args.best_live, bounds),
        (bool(args.live_causes), causes),
        (bool(args.home_flow), home_flows),
        (bool(args.combines), combines),
    )
    for asked, answer in others:
        if asked:
            return answer(args)
    begun = time.monotonic()
    console = Console(stderr=True)
    outcomes = {}
    # The longest first, so that both processes end together.
    jobs = [(i, args.hours, args.seed, args.drift_exponent) for i in (4, 3, 2, 1, 0)]
    with ProcessPoolExecutor(2) as pool, console.status("harvesting") as status:
        for (index, *_), outcome in zip(jobs, pool.map(one, jobs), strict=True):
            outcomes[index] = outcome
            status.update(f"harvesting: {outcome.strategy.name} done after {time.monotonic() - begun:.0f} s")
    ordered = [outcomes[i] for i in sorted(outcomes)]
    found = document(ordered, args.hours, args.seed, time.monotonic() - begun)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "season.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    draw(ordered, args.out / "season.png")
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    table = Table(title=f"{args.hours:g} h, seed {args.seed}, {found['took_s']} s")
    heads = ["strategy", "loads", "mean |load error|, %", "within 1 %", "posted", "by thirds"]
    heads += ["1 Hz mean, %", "1 Hz 95 %", "sweeps", "updates"]
    for head in heads:
        table.add_column(head, justify="left" if head == "strategy" else "right")
    for row in found["strategies"]:
        table.add_row(*(str(value) for value in row.values()))
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
