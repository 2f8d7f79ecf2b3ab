"""One wrong ticket, or two exchanged ones, among the weighed loads of machines of other laws.

    python -m studies.load_laws.mistakes --first 9301 --machines 1

Each machine of `machines.py` is calibrated by its first two, three and four loads with a mistake in the first one's ticket, and
judged on ten further loads. Misleading is a calibration that is accepted without a word about a ticket and puts a further load
off by more than 3 of its stated deviations and 3 %.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from studies.load_laws.machines import LAWS, MACHINE, SHIPPED, draw, judged
from yieldmon import api
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads

_KG_PER_LB = 0.45359237
Mistake = Callable[[Sequence[WeighedLoad]], list[WeighedLoad]]


def _weighing(load: WeighedLoad, kg: float) -> WeighedLoad:
    return replace(load, weighed_kg=kg, std_dev_kg=0.005 * kg)


def _first(change: Callable[[float], float]) -> Mistake:
    return lambda loads: [_weighing(loads[0], change(loads[0].weighed_kg)), *loads[1:]]


def _exchanged(loads: Sequence[WeighedLoad]) -> list[WeighedLoad]:
    first, *between, last = loads
    return [_weighing(first, last.weighed_kg), *between, _weighing(last, first.weighed_kg)]


MISTAKES: Mapping[str, Mistake] = {
    "none": list,
    "pounds for kilograms": _first(lambda kg: kg / _KG_PER_LB),
    "kilograms for pounds": _first(lambda kg: kg * _KG_PER_LB),
    "short tons for tonnes": _first(lambda kg: kg * 1000.0 / (2000.0 * _KG_PER_LB)),
    "10 % too heavy": _first(lambda kg: 1.1 * kg),
    "20 % too light": _first(lambda kg: 0.8 * kg),
    "40 % too heavy": _first(lambda kg: 1.4 * kg),
    "tare of 3 t": _first(lambda kg: kg + 3000.0),
    "tare of 3 t in all": lambda loads: [_weighing(load, load.weighed_kg + 3000.0) for load in loads],
    "two exchanged": _exchanged,
}


def outcome(name: str, seed: int, count: int, mistake: Mistake) -> str:
    """refused, named, asked, right or misleading."""
    drawn, model = draw(name, seed), api.ForwardModel(MACHINE, SHIPPED.effects)
    try:
        found = calibrate_loads(model, SHIPPED, mistake(drawn.weighed[:count]))
    except ValueError:
        return "refused"
    if found.refused:
        return "refused"
    if found.outliers:
        return "named"
    asked = ("may be wrong", "scatter by more", "unit of their column")
    if any(words in sentence for words in asked for sentence in found.sentences):
        return "asked"
    error, std_dev = np.abs(judged(found.parameter_set, drawn)).T
    return "misleading" if np.any((error > 3.0) & ~(error <= 3.0 * std_dev)) else "right"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1, help="first seed (default: %(default)s)")
    parser.add_argument("--machines", type=int, default=1, help="of each law (default: %(default)s)")
    parser.add_argument("--loads", nargs="*", type=int, default=[2, 3, 4], help="numbers of weighed loads (default: 2 3 4)")
    parser.add_argument("--mistakes", nargs="*", default=list(MISTAKES), choices=MISTAKES, help="these (default: all)")
    args = parser.parse_args()
    kinds = ("refused", "named", "asked", "right", "misleading")
    print(f"| mistake | loads | {' | '.join(kinds)} |\n|---|---|{'---|' * len(kinds)}")
    for title in args.mistakes:
        mistake = MISTAKES[title]
        for count in args.loads:
            seen = Counter(
                outcome(name, seed, count, mistake) for name in LAWS for seed in range(args.first, args.first + args.machines)
            )
            print(f"| {title} | {count} | {' | '.join(str(seen[kind]) for kind in kinds)} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
