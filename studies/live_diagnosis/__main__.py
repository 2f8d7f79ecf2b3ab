"""Run the daemon beside a machine with an effect that it does not know, until it has been told.

    python -m studies.live_diagnosis                                   # all cases, results.json and live-diagnosis.png here
    python -m studies.live_diagnosis --case plate_friction --out /tmp/live --hours 2

For each case: hours of harvest in simulated time through the daemon itself (threads, store, journal), with sweeps; when the fault
ModelDisagrees was raised; `yieldmon diagnose` on the store while the daemon runs; if an effect is named, --adopt onto the
daemon's parameter file and a reload; more hours of harvest; the error of the 1 Hz flow before and after, against the combine's
truth. The seconds after adoption are also worked out with the parameters before it. `--json` prints the document.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.progress import TaskID

    from studies.live_diagnosis.cases import Case
    from yieldmon.physics.machine import Machine
    from yieldmon.physics.numerics import Array
    from yieldmon.plant.combine import VirtualCombine
    from yieldmon.service.storage.rows import SecondRow

    Run = tuple[dict[str, Any], dict[str, tuple[Array, Array]]]
    """A case's entry of the document, and by where the plate was hours and errors."""

FOLDER = Path(__file__).resolve().parent
SEED = 20261121


@dataclass
class Lived:
    """What a case left behind. diagnosis: the command's JSON, in took_s seconds; last_before: number of the second before it."""

    case: Case
    combine: VirtualCombine
    machine: Machine
    store: Path
    diagnosis: dict[str, Any]
    took_s: float
    last_before: int
    adopted: str | None
    start_s: float


def live_through(case: Case, folder: Path, args: argparse.Namespace, tell: Callable[[float], None]) -> Lived:
    """The harvest with the daemon beside it, diagnosis and adoption in between."""
    from studies.live_diagnosis import cases as live
    from studies.live_diagnosis.stepped_daemon import SteppedDaemon
    from yieldmon.files import machine_file, parameter_file

    hours, seed = args.hours, args.seed
    machine = machine_file.load(None)
    folder.mkdir(parents=True, exist_ok=True)
    parameter_file.save(live.calibrated_at_home(case, machine, parameter_file.load(), seed), folder / "parameters.yaml")
    angles = ", ".join(f"{angle:g}" for angle in live.SWEEP_ANGLES_DEG)
    (folder / "yieldmon.yaml").write_text(
        "parameter_file: parameters.yaml\nbus: {transmit_max_age_s: 60}\nlogging: {level: error}\n"
        f"sweep: {{first_after_s: 120, interval_s: {args.interval:g}, angles_deg: [{angles}]}}\n"
    )
    store = folder / "yieldmon.sqlite"
    combine = live.combine_of(case, machine, sum(hours), seed)
    total_s = 3600.0 * sum(hours)
    adopted = None
    with SteppedDaemon(combine, folder / "yieldmon.yaml", folder) as stepped:
        stepped.run_until(3600.0 * hours[0], lambda t: tell(t / total_s))
        command = ["diagnose", str(store), "--seed", str(seed), "--json", "--table", str(folder / "sweeps.csv"), "--force"]
        begin_s = time.monotonic()
        found = yieldmon([*command, "--plan", str(folder / "plan.csv"), "--report", str(folder / "report")])
        diagnosis = json.loads(found.stdout)
        took_s = time.monotonic() - begin_s
        last_before = rows_of(store)[-1].number
        if diagnosis["verdict"] == "effect":
            yieldmon([*command, "--adopt", str(folder / "parameters.yaml")])
            adopted = f"reload: {stepped.reload()}"
        stepped.run_until(total_s, lambda t: tell(t / total_s))
    return Lived(case, combine, machine, store, diagnosis, took_s, last_before, adopted, stepped.START_S)


def judged(lived: Lived, args: argparse.Namespace) -> Run:
    """The case's entry of the document, and hours and errors for the picture."""
    import numpy as np

    from studies.live_diagnosis import cases as live
    from yieldmon.estimation.estimators import estimator_of
    from yieldmon.files import parameter_file
    from yieldmon.physics.machine import RPM
    from yieldmon.service.storage.store import Store

    with Store(lived.store) as store:
        events = [e for e in store.faults(10_000) if e.code == "ModelDisagrees" and e.active]
        sweeps = store.sweeps(10_000)
        versions = {v.version: v.document for v in store.parameter_versions()}
    every = rows_of(lived.store)
    before = [row for row in every if row.number <= lived.last_before]
    after = every[len(before) :]
    home_deg = float(np.degrees(lived.machine.home_plate_angle_rad))

    def errors(rows: Sequence[SecondRow]) -> dict[str, dict[str, float]]:
        found = live.flow_errors(rows, lived.combine, lived.start_s, home_deg)
        return {k: {n: round(v, 3) for n, v in asdict(e).items()} for k, e in found.items()}

    def with_parameters(version: int) -> list[SecondRow]:
        """The seconds after adoption with one set of parameters, window by window, no filter."""
        loop = estimator_of(lived.machine, parameter_file.from_document(versions[version], "store"))
        force, angle, rpm = (
            np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in after], dtype=float)
            for name in ("force_n", "plate_angle_deg", "elevator_speed_rpm")
        )
        flow = loop.estimate(force, np.radians(angle), rpm * RPM).mass_flow_kg_s
        return [
            replace(row, mass_flow_kg_s=float(v) if np.isfinite(v) and row.mass_flow_kg_s is not None else None)
            for row, v in zip(after, flow, strict=True)
        ]

    shown = [row for row in every if "ModelDisagrees" in row.faults.split()]
    found = {
        "case": lived.case.name,
        "effects": {name: dict(values) for name, values in lived.case.effects.items()},
        "hours": list(args.hours),
        "sweep_interval_s": args.interval,
        "sweeps": {outcome: sum(s.outcome == outcome for s in sweeps) for outcome in ("updated", "not_learned", "aborted")},
        "fault": {
            "raised_h": round((shown[0].time_s - lived.start_s) / 3600.0, 2) if shown else None,
            "last_shown_h": round((shown[-1].time_s - lived.start_s) / 3600.0, 2) if shown else None,
            "after_sweeps": len({r.sweep_id for r in every if r.usable_for_calibration and r.number < shown[0].number})
            if shown
            else None,
            "texts": [event.detail for event in events],
        },
        "diagnose_s": round(lived.took_s, 1),
        "verdict": lived.diagnosis["verdict"],
        "named": lived.diagnosis["effects"],
        "gap": lived.diagnosis["gap"],
        "where": lived.diagnosis["where"],
        "next_experiment": lived.diagnosis["next_experiment"],
        "adopted": lived.adopted,
        "parameters": {
            str(version): {k: v for k, v in versions[version].items() if k in ("friction", "density", "restitution", "effects")}
            for version in sorted({1, before[-1].parameter_version, after[0].parameter_version, every[-1].parameter_version})
        },
        "flow_error_pct": {
            "before": errors(before),
            "after": errors(after),
            "after_with_the_parameters_before": errors(with_parameters(before[-1].parameter_version)),
            "after_with_the_parameters_adopted": errors(with_parameters(after[0].parameter_version)),
        },
    }
    return found, live.errors_over_time(every, lived.combine, lived.start_s, home_deg)


def yieldmon(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """The command itself."""
    done = subprocess.run([sys.executable, "-m", "yieldmon.cli.main", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"yieldmon {' '.join(arguments)}: {done.stderr}")
    return done


def rows_of(path: Path) -> Sequence[SecondRow]:
    """All seconds of a store."""
    from yieldmon.service.logs.recorded import read_seconds

    return read_seconds(path)


def draw(runs: Sequence[Run], path: Path) -> None:
    """Signed error of the 1 Hz flow in every case, by where the plate was, with the fault and the adoption marked."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 2.6 * len(runs)), layout="constrained")
    for axes, (found, points) in zip(figure.subplots(len(runs), 1, squeeze=False)[:, 0], runs, strict=True):
        for name, colour, size in (("home", "tab:blue", 1.0), ("away", "tab:orange", 6.0)):
            axes.scatter(*points[name], s=size, color=colour, lw=0, alpha=0.5, label=f"plate {name}")
        fault = found["fault"]
        if fault["raised_h"] is not None:
            axes.axvspan(fault["raised_h"], fault["last_shown_h"], color="tab:red", alpha=0.12, lw=0, label="ModelDisagrees")
        if found["adopted"]:
            axes.axvline(found["hours"][0], color="k", ls="--", lw=1.0, label="adopted")
        axes.set_ylim(-30.0, 30.0)
        axes.set_ylabel("flow error, %")
        named = ", ".join(effect["name"] for effect in found["named"])
        axes.set_title(f"{found['case']}: {found['verdict']}{': ' if named else ''}{named}", fontsize=10)
        axes.grid(alpha=0.3)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, markerscale=3)
    axes.set_xlabel("hours of harvest")
    figure.savefig(path, dpi=110)


def show(document: dict[str, Any]) -> None:
    """The table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"seed {document['seed']}: mean |error| / 95 % / bias of the 1 Hz flow, %")
    for head in ("case", "fault, h", "verdict", "before: home", "before: away", "after: home", "after: away", "fault gone"):
        table.add_column(head)
    for run in document["runs"]:
        errors = run["flow_error_pct"]
        cells = [
            " / ".join(f"{errors[when][where][key]:.2f}" for key in ("mean_abs_pct", "p95_abs_pct", "bias_pct"))
            for when in ("before", "after") for where in ("home", "away")
        ]  # fmt: skip
        fault = run["fault"]
        verdict = ", ".join([run["verdict"], *(e["name"] for e in run["named"])])
        gone = "-" if fault["raised_h"] is None else str(fault["last_shown_h"] < sum(run["hours"]) - 0.01)
        table.add_row(run["case"], str(fault["raised_h"]), verdict, *cells, gone)
    Console(width=200).print(table)


def main() -> int:
    """Exit code 0 when all cases ran."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from studies.live_diagnosis import cases as live

    names = [case.name for case in live.CASES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", action="append", choices=names, help="a case, may be given again (default: all)")
    parser.add_argument("--hours", type=float, nargs=2, default=(4.0, 2.0), metavar=("BEFORE", "AFTER"))
    parser.add_argument("--interval", type=float, default=600.0, metavar="S", help="between sweeps (default: 600)")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--files", type=Path, metavar="DIR", help="keep stores, tables and reports here (default: thrown away)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for results.json and the picture")
    parser.add_argument("--json", action="store_true", help="print the document")
    args = parser.parse_args()
    console = Console(stderr=True)
    runs = []
    with tempfile.TemporaryDirectory(prefix="yieldmon-live-") as scratch, Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"), TimeElapsedColumn(),
        console=console, disable=not sys.stderr.isatty(),
    ) as bar:  # fmt: skip
        for name in args.case or names:
            task = bar.add_task(name, total=1.0)
            folder = (args.files or Path(scratch)) / name
            case = next(case for case in live.CASES if case.name == name)

            def tell(share: float, task: TaskID = task) -> None:
                bar.update(task, completed=share)

            lived = live_through(case, folder, args, tell)
            runs.append(judged(lived, args))
            bar.update(task, completed=1.0)
            found = runs[-1][0]
            console.print(f"{name}: fault {found['fault']['raised_h']} h, verdict {found['verdict']}", soft_wrap=True)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    document = {"seed": args.seed, "commit": commit, "runs": [found for found, _ in runs]}
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "results.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    draw(runs, args.out / "live-diagnosis.png")
    if args.json:
        print(json.dumps(document, indent=1))
    else:
        show(document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
