"""What the waveform tells: the tables of README.md.

    python -m studies.waveform information --draws 60     # Fisher information, and the estimator's scatter
    python -m studies.waveform fill                       # volume flow from discrete-element pulses, loads and angles left out
    python -m studies.waveform kernels                    # kernel noise in discrete-element forces
    python -m studies.waveform hidden                     # effects that the model does not know, through the monitor
    python -m studies.waveform pack LEDGER... --out F.npz # a campaign's forces at 10 kHz

Prints one JSON document.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

SEED = 20261122


def _document(args: argparse.Namespace) -> Any:
    if args.part == "information":
        from studies.waveform import information

        return {"table": information.table(), "monte_carlo": information.against_monte_carlo(args.draws, args.seed)}
    if args.part == "fill":
        from studies.waveform import fill

        return [row for indexed in (True, False) for row in fill.report(0.1, indexed)]
    if args.part == "hidden":
        from studies.waveform import hidden

        return hidden.report(args.seed)
    from studies.waveform import kernels

    if args.part == "pack":
        return {"rows": kernels.pack(args.ledgers, args.out)}
    return kernels.report(args.seed)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m studies.waveform", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("information", "fill", "kernels", "hidden", "pack"))
    parser.add_argument("ledgers", nargs="*", type=Path, help="pack: folders of campaigns")
    parser.add_argument("--out", type=Path, default=Path("kernel_forces.npz"))
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args()
    json.dump(_document(args), sys.stdout, indent=1)
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
