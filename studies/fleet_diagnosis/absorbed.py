"""Why are machines' own effects missed? One machine at a time, with the shared effect at its true value in the model.

    python -m studies.fleet_diagnosis.absorbed [--seed N] [EFFECT=SIZE ...]

For each own effect: the gain in chi-square that its signature promises by its size, the gain that it shows in the table that
`fleet diagnose` makes of the sweeps, the gain it would show with the true flows, and the chi-square of the cells without it when
the flow follows the parameters, with grain free for the machine and with the fleet's grain. Seeds are none of the draws'.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from studies.fleet_diagnosis.__main__ import DAYS, OWN, SHARED, calibrated, day_of, shown
from yieldmon.discrepancy import candidates, diagnosis, fit, observations
from yieldmon.discrepancy.noise import estimate
from yieldmon.estimation import sweep_flow
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import real
from yieldmon.service import sweep_table

SEED = 77001
COMMON, IN_MODEL = "plate_friction", {"plate_friction.coefficient": 0.2}
CASES = (
    "none=0", "lever_arm=0.4", "lever_arm=1.2", "cell_nonlinearity=0.5", "plate_buildup=1.3", "plate_angle_offset=2.1",
    "stream_spread=12",
)  # fmt: skip
FLEET_GRAIN = {"friction": (0.18, 0.01), "density": (1074.0, 25.0), "restitution": (0.50, 0.015)}
"""Of the machine without an own effect, and how far a machine's may differ."""
NEEDED_SD = 4.0
_UNITS = {"angle_deg": np.pi / 180.0, "half_width_deg": np.pi / 180.0, "slope": 1.0, "mass_kg": 1.0, "friction": 1.0}
"""Of the model's parameter in that of the virtual combine; the cell's is stated otherwise."""
_FLOWS_KG_S = np.geomspace(1.0, 24.0, 160)

Array = NDArray[Any]
Force = Callable[[Array, Array, Array], Array]


class TrueFlows:
    """In the place of the open loop: the flow that makes the force at home with this machine's own effect."""

    def __init__(self, force: Force) -> None:
        self._force = force

    def __call__(self, *_: object) -> TrueFlows:
        """As the open loop's constructor."""
        return self

    def invert(self, force_n: Array, angle_rad: Array, speed_rad_s: Array, _: object = None) -> Array:
        """Flow, kg/s."""
        found = np.empty(force_n.size)
        for i in range(force_n.size):
            at = np.full(_FLOWS_KG_S.size, angle_rad[i]), np.full(_FLOWS_KG_S.size, speed_rad_s[i])
            found[i] = np.interp(force_n[i], self._force(_FLOWS_KG_S, *at), _FLOWS_KG_S)
        return found


def following(values: Mapping[str, float], effects: tuple[str, ...]) -> Callable[..., Array]:
    """Predictions at the flow for which the parameters make the force at home that these `values` make at the cell's flow."""

    def predictions(frame: fit.Frame, added: tuple[str, ...], moved: Mapping[str, Any]) -> Array:
        grid, machine = frame.cells.layout, frame.cells.rows.machine
        home = np.full(grid.plate_angle_rad.shape, machine.home_plate_angle_rad)
        given = ForwardModel(machine, effects, nodes=frame.nodes)
        model = ForwardModel(machine, (*frame.known, *added), nodes=frame.nodes)
        together = {**frame.fixed, **moved}
        spread = {name: np.asarray(v)[..., None] if np.ndim(v) else np.asarray(v) for name, v in together.items()}

        def force(model: ForwardModel, angle: Array, load: Array, by: Mapping[str, Any]) -> Array:
            where = Conditions(angle, grid.elevator_speed_rad_s, mass_flow_kg_s=load, moisture_pct=grid.moisture_pct)
            return np.asarray(model.force(where, by, overfull="nan"))

        with np.errstate(all="ignore"):
            then = real(force(given, home, grid.load, values))
            power = np.log(real(force(given, home, 1.001 * grid.load, values)) / then) / np.log(1.001)
            power = np.where(np.isfinite(power), power, 1.0)
            load: Array = grid.load
            for _ in range(3):
                step = then / force(model, home, load, spread)
                step = np.where(np.isfinite(real(step)), step, 1.0)
                load = load * real(step) ** (1.0 / power) * (1.0 + 1j * np.imag(step) / real(step) / power)
            out = force(model, grid.plate_angle_rad, load, spread)
        return np.asarray(out.reshape(*out.shape[:-2], -1)[..., grid.place])

    return predictions


def _started(frame: fit.Frame, effects: tuple[str, ...], start: dict[str, float]) -> tuple[float, dict[str, float]] | None:
    """Where flows follow, no gain is linear: the start as it is."""
    residual = (real(fit.predictions(frame, effects, start)) - frame.cells.mean) / frame.sd
    return (float(residual @ residual), start) if np.all(np.isfinite(residual)) else None


def _base(days: tuple[Any, ...], machine: Machine, parameters: Any) -> fit.Fit:
    """The model without the own effect, fitted to the cells that `fleet diagnose` fits."""
    table = sweep_table.of_seconds(days, "sweeps", machine, parameters).table
    rows = observations.from_table(table, machine)
    options = diagnosis.Options(keep_effects=True)
    rows = rows.take(~observations.seal(rows, options.hold_out, options.seed))
    noise, outlying = estimate(rows)
    kept = np.ones(len(rows), dtype=bool)
    kept[outlying] = False
    grouped = observations.cells(rows.take(kept))
    return fit.fit_base(fit.base_frame(grouped, noise.of_cells(grouped), parameters, "restitution", keep_effects=True))


def _pooled(base: fit.Fit) -> fit.Fit | None:
    """The same with the fleet's grain."""
    grain = tuple(
        replace(b, lower=mid - width, upper=mid + width, start=mid)
        for b in base.frame.base
        for mid, width in (FLEET_GRAIN[b.name],)
    )
    return fit.fit(replace(base.frame, base=grain), ())


def _gain(base: fit.Fit, effect: str) -> float:
    return max(candidates.score(base, candidates.signature(base, law)).gain for law in candidates.lawful((effect,)))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.fleet_diagnosis.absorbed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("cases", nargs="*", default=CASES, metavar="EFFECT=SIZE")
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args()
    machine, shipped = Machine(), parameter_file.load()
    print("own effect                  expected  gain  true flows   chi-square: own grain  fleet's grain  cells")
    for case in args.cases:
        own, _, size = case.partition("=")
        hidden = {COMMON: SHARED[COMMON]} | ({own: {next(iter(OWN[own])): float(size)}} if own in OWN else {})
        force = shown(machine, hidden)
        days = tuple(day_of(machine, force, np.random.default_rng([args.seed, 1, day])) for day in range(DAYS))
        known = calibrated(machine, shipped, force)
        known = replace(known, values={**known.values, **IN_MODEL})
        base = _base(days, machine, known)
        with patch.object(sweep_flow, "OpenLoop", TrueFlows(force)):
            oracle = _base(days, machine, known)
        with (
            patch.object(fit, "predictions", following(known.values, known.effects)),
            patch.object(fit, "_solve_gain", _started),
        ):
            carried = _base(days, machine, known)
            pooled = _pooled(carried)
        words = [f"{case:26}", *(f"{'':>9}" for _ in range(3))]
        if own in OWN:
            detectable = diagnosis.minimum_detectable([candidates.signature(base, own)]).get(own, float("nan"))
            unit = _UNITS.get(next(iter(OWN[own])), float("nan"))
            expected = (NEEDED_SD * float(size) * unit / detectable) ** 2
            words[1:] = [f"{x:9.1f}" for x in (expected, _gain(base, own), _gain(oracle, own))]
        last = pooled.chi2 if pooled is not None else float("nan")
        print(*words, f"{carried.chi2:18.0f} {last:14.0f} {len(base.frame.cells):7d}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
