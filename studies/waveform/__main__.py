"""What the waveform tells: the tables of README.md.

    python -m studies.waveform information --draws 1000   # Fisher information, and the estimator's scatter
    python -m studies.waveform identifiability            # what mean, contrast, waveform, kernels and a sweep determine
    python -m studies.waveform fill                       # volume flow from discrete-element pulses, loads and angles left out
    python -m studies.waveform many-heaps                 # the same of trains of several heaps, which the campaign lacks
    python -m studies.waveform attempts                   # what limits that
    python -m studies.waveform edges                      # the same with pulses of loads and angles around those judged
    python -m studies.waveform kernels                    # kernel noise in discrete-element forces
    python -m studies.waveform verdicts                   # what the daemon says of kernel noise, by cell
    python -m studies.waveform hidden                     # effects that the model does not know, through the monitor
    python -m studies.waveform heaps                      # heaps of another cross-section than calibrated, through the monitor
    python -m studies.waveform cost                       # processor time, on and off
    python -m studies.waveform pictures --out DIR         # pulse.png, fill.png (of fill.json)
    python -m studies.waveform season --seeds 30          # load errors of a season by channel, estimators alone
    python -m studies.waveform kernel-updates --seeds 30        # the same where kernel noise updates the parameters
    python -m studies.waveform daemon-season --seeds 30 --seed 17001 --out F.json   # through the monitor, with kernels; goes on
    python -m studies.waveform season-causes              # what the errors of those seasons come from, by regression
    python -m studies.waveform season-bound               # the best that mean force and shape can do in those seasons
    python -m studies.waveform placed                     # discrete-element pulses on uneven chains, through the monitor
    python -m studies.waveform again                      # what the samples show of grain that strikes the plate again
    python -m studies.waveform common-error               # what mean force and kernels are off by alike: waveform.hit_sd
    python -m studies.waveform noise-by-force             # noise of kernels along the pulse of discrete elements
    python -m studies.waveform shape --out F.yaml         # the law of those pulses, with its range (config/pulse-shape.yaml)
    python -m studies.waveform pack LEDGER... --out F.npz # a campaign's forces at 10 kHz

Prints one JSON document.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

SEED = 20261122


def _information(args: argparse.Namespace) -> Any:
    from studies.waveform import information

    return {"table": information.table(), "monte_carlo": information.against_monte_carlo(args.draws, args.seed)}


def _identifiability(args: argparse.Namespace) -> Any:
    from studies.waveform import identifiability

    return identifiability.report()


def _fill(args: argparse.Namespace) -> Any:
    from studies.waveform import fill

    return fill.report(0.1)


def _attempts(args: argparse.Namespace) -> Any:
    from studies.waveform import attempts

    return attempts.report()


def _edges(args: argparse.Namespace) -> Any:
    from studies.waveform import edges

    return edges.report()


def _kernels(args: argparse.Namespace) -> Any:
    from studies.waveform import kernels

    return kernels.report(args.seed)


def _hidden(args: argparse.Namespace) -> Any:
    from studies.waveform import hidden

    return hidden.report(args.seed)


def _cost(args: argparse.Namespace) -> Any:
    # As the service has it (systemd/yieldmon.service).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from studies.waveform import cost

    return cost.report(args.seed)


def _verdicts(args: argparse.Namespace) -> Any:
    from studies.waveform import verdicts

    return verdicts.report(args.seed)


def _pictures(args: argparse.Namespace) -> Any:
    from studies.waveform import pictures

    return pictures.draw(args.out or Path(__file__).resolve().parent)


def _season(args: argparse.Namespace) -> Any:
    from studies.waveform import season

    return season.report(args.seeds, args.seed)


def _kernel_updates(args: argparse.Namespace) -> Any:
    from studies.waveform import kernel_updates

    return kernel_updates.report(args.seeds, args.seed)


def _heaps(args: argparse.Namespace) -> Any:
    from studies.waveform import heaps

    return heaps.report(args.seed)


def _scheduling(args: argparse.Namespace) -> Any:
    from studies.waveform import scheduling

    return scheduling.report(args.seeds, args.seed)


def _between(args: argparse.Namespace) -> Any:
    from studies.waveform import fill

    return fill.between()


def _many_heaps(args: argparse.Namespace) -> Any:
    from studies.waveform import fill

    return fill.many_heaps()


def _daemon_season(args: argparse.Namespace) -> Any:
    from studies.waveform import daemon_season

    names = tuple(args.columns.split(",")) if args.columns else daemon_season.NAMES
    found = before = json.loads(args.out.read_text()) if args.out is not None and args.out.exists() else None
    for found in daemon_season.report(args.seeds, args.seed, before, args.bias_slope, names, args.weighed_loads):
        row = {key: value for key, value in found["seasons"][-1].items() if not isinstance(value, list)}
        print(json.dumps(row), file=sys.stderr, flush=True)
        if args.out is not None:
            args.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def _season_causes(args: argparse.Namespace) -> Any:
    from studies.waveform import season_causes

    return season_causes.report()


def _season_bound(args: argparse.Namespace) -> Any:
    from studies.waveform import season_bound

    return season_bound.report()


def _placed(args: argparse.Namespace) -> Any:
    from studies.waveform import placed

    return placed.report(args.seed)


def _again(args: argparse.Namespace) -> Any:
    from studies.waveform import again

    return again.report(args.seed)


def _noise_by_force(args: argparse.Namespace) -> Any:
    from studies.waveform import kernels

    return kernels.by_force(kernels.heaps(kernels.FORCES, kernels.MORE_FORCES))


def _common_error(args: argparse.Namespace) -> Any:
    from studies.waveform import common_error

    return common_error.report()


def _shape(args: argparse.Namespace) -> Any:
    from studies.waveform import fill
    from yieldmon.files import pulse_shape_file

    out = args.out or Path("pulse-shape.yaml")
    pulse_shape_file.save(fill.shape_law(), out, source="discrete elements, python -m studies.waveform shape")
    return {"written": str(out)}


def _pack(args: argparse.Namespace) -> Any:
    from studies.waveform import kernels

    return {"rows": kernels.pack(args.ledgers, args.out or Path("kernel_forces.npz"), rows_a_seed=args.rows_a_seed)}


_PARTS = {
    "information": _information, "fill": _fill, "attempts": _attempts, "kernels": _kernels, "hidden": _hidden, "cost": _cost,
    "pictures": _pictures, "season": _season, "daemon-season": _daemon_season, "verdicts": _verdicts, "shape": _shape,
    "pack": _pack, "edges": _edges, "kernel-updates": _kernel_updates, "heaps": _heaps, "scheduling": _scheduling,
    "between": _between, "identifiability": _identifiability, "season-causes": _season_causes, "noise-by-force": _noise_by_force,
    "many-heaps": _many_heaps, "season-bound": _season_bound, "placed": _placed, "again": _again, "common-error": _common_error,
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m studies.waveform", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=tuple(_PARTS))
    parser.add_argument("ledgers", nargs="*", type=Path, help="pack: folders of campaigns")
    parser.add_argument("--rows-a-seed", type=int, default=1, help="pack: leave seeds with fewer rows out (default 1)")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seeds", type=int, default=30, help="season: so many, from --seed on")
    parser.add_argument("--bias-slope", type=float, help="daemon-season: d ln(b) / d restitution (default: of kernels.json)")
    parser.add_argument("--columns", help="daemon-season: names of strategies, with commas, f among them (default: all)")
    parser.add_argument("--weighed-loads", type=int, default=1, help="daemon-season: loads that kernel noise is calibrated on")
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args()
    json.dump(_PARTS[args.part](args), sys.stdout, indent=1)
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
