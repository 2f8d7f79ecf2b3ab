"""The cases of the study: what is hidden, in which design, under which noise; all from one seed a case."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.physics.machine import Machine

from . import generator as g

#: Largest sizes that stay physical; a second entry below 0 where either sign is.
SIZES: dict[str, tuple[float, float]] = {
    "paddle_leakage": (0.0, 0.9),
    "chain_slip": (0.0, 0.2),
    "paddle_wear": (0.0, 0.03),
    "residual_radial_speed": (0.0, 0.6),
    "speed_dependent_shape": (-1.5, 1.5),
    "release_angle": (-0.3, 0.3),
    "gravity": (9.81, 9.81),
    "air_drag": (0.0, 0.4),
    "stream_spread": (0.0, 0.35),
    "miss_capture": (0.0, 0.95),
    "plate_overshoot": (0.0, 0.03),
    "plate_friction": (0.0, 0.4),
    "jet_shielding": (0.0, 60.0),
    "speed_dependent_restitution": (0.0, 0.8),
    "secondary_impact": (0.0, 0.9),
    "resting_grain": (0.0, 0.2),
    "zero_offset": (-12.0, 12.0),
    "plate_angle_offset": (-0.1, 0.1),
    "lever_arm": (-1.0, 1.0),
    "cell_nonlinearity": (0.0, 0.004),
    "plate_buildup": (0.0, 20.0),
    "moisture_dependence": (0.0, 0.06),
    "unpushed_layers": (0.0, 12.0),
    "stream_rise": (0.0, 0.3),
    "speed_dependent_friction": (-1.5, 1.5),
}
LATER = ("speed_dependent_friction",)
"""Effects that came after the cases of the records: pairs are drawn without them, so that a salt's other cases stay."""
MANY_SPEEDS = ("speed_dependent_shape", "speed_dependent_friction")
"""Effects of elevator speed alone, which one speed cannot show."""
#: The candidate's parameter that carries the size.
LEADING = {
    "paddle_leakage": "loss_at_full", "chain_slip": "share", "paddle_wear": "length_m", "residual_radial_speed": "share",
    "speed_dependent_shape": "exponent", "release_angle": "angle_rad", "gravity": "acceleration_m_s2", "air_drag": "rate_per_m",
    "stream_spread": "spread_rad", "miss_capture": "share", "plate_overshoot": "depth_m", "plate_friction": "coefficient",
    "jet_shielding": "rate_per_m", "speed_dependent_restitution": "exponent", "secondary_impact": "share",
    "resting_grain": "time_s", "zero_offset": "force_n", "plate_angle_offset": "angle_rad", "lever_arm": "slope",
    "cell_nonlinearity": "softening_per_n", "plate_buildup": "weight_n", "moisture_dependence": "friction_per_pct",
    "unpushed_layers": "rate_per_rad", "stream_rise": "ratio", "speed_dependent_friction": "exponent",
}  # fmt: skip
REPLICATES = 3
SALT = 8803
"""Of every case's seed and of the pairs drawn: another one makes a study of fresh cases."""


@dataclass(frozen=True)
class Case:
    """kind: hidden, clean, outside, removed or pair; hidden: effects in the data; without: taken from the library."""

    kind: str
    hidden: tuple[str, ...]
    number: int
    noise_pct: float
    speeds: str

    @property
    def key(self) -> str:
        """Unique and stable."""
        return f"{self.kind}/{'+'.join(self.hidden) or 'nothing'}/{self.noise_pct:g}/{self.speeds}/{self.number}"

    @property
    def without(self) -> tuple[str, ...]:
        """Effects taken out of the library."""
        return self.hidden if self.kind == "removed" else ()


@dataclass(frozen=True)
class Data:
    """Rows of a case, the grain and the sizes that were hidden, and the largest change they make over the largest reading."""

    rows: Rows
    grain: g.Grain
    sizes: dict[str, float]
    change: float


def all_cases(per_effect: int, per_effect_noisy: int, clean: int, outside: int, removed: int, pairs: int) -> list[Case]:
    """The study, in an order in which every kind advances together."""
    groups: list[list[Case]] = []
    for name in SIZES:
        single_too = name not in MANY_SPEEDS
        groups.append([Case("hidden", (name,), i, 1.0, "one" if i % 2 and single_too else "many") for i in range(per_effect)])
        groups.append(
            [Case("hidden", (name,), i, 3.0, "one" if i % 2 and single_too else "many") for i in range(per_effect_noisy)]
        )
        groups.append([Case("removed", (name,), i, 1.0, "many") for i in range(removed)])
    groups.append([Case("clean", (), i, 1.0 if i % 2 else 3.0, "many" if i % 4 < 2 else "one") for i in range(clean)])
    for kind in g.OUTSIDE:
        groups.append([Case("outside", (kind,), i, 1.0, "many") for i in range(outside)])
    rng = np.random.default_rng(SALT)
    drawn = [name for name in SIZES if name not in LATER]
    groups.append(
        [Case("pair", tuple(sorted(map(str, rng.choice(drawn, 2, replace=False)))), i, 1.0, "many") for i in range(pairs)]
    )
    return list(_in_turn(groups))


def _in_turn(groups: list[list[Case]]) -> Iterator[Case]:
    longest = max(map(len, groups))
    placed = [((i + 0.5) / len(group), n, case) for n, group in enumerate(groups) for i, case in enumerate(group)]
    assert longest
    yield from (case for _, _, case in sorted(placed, key=lambda p: (p[0], p[1])))


def make(case: Case) -> Data:
    """Rows of one case: random grain, the effect scaled to a change of 5 to 20 % of full scale, noise, 1 % outliers."""
    rng = np.random.default_rng([zlib.crc32(case.key.encode()), SALT])
    grain = g.Grain(float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.3, 0.75)), float(rng.uniform(900.0, 1500.0)))
    angle, flow, speed, moisture, trial = _design(case, rng)
    base = g.force(angle, speed, flow, moisture, grain, {})
    full = float(np.nanmax(base))
    sizes: dict[str, float] = {}
    clean = base
    if case.kind == "outside":
        size = float(rng.uniform(0.06, 0.15))
        clean = g.outside(case.hidden[0], base, angle, speed, flow, size)
        sizes = {case.hidden[0]: size}
    elif case.hidden:
        for name in case.hidden:
            sizes[name] = _size(name, float(rng.uniform(0.05, 0.2)), rng, (angle, speed, flow, moisture), grain, base)
        clean = g.force(angle, speed, flow, moisture, grain, sizes)
    change = float(np.nanmax(np.abs(clean - base))) / full
    share = 0.01 * case.noise_pct
    sd = np.hypot(share * np.abs(clean), 0.15 * share * full)
    reading = clean + sd * rng.standard_normal(len(clean))
    odd = rng.random(len(clean)) < 0.01
    reading = np.where(odd, reading + rng.choice([-1.0, 1.0], len(clean)) * rng.uniform(0.15, 0.4, len(clean)) * full, reading)
    keep = np.isfinite(reading)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, speed, flow, moisture, reading, np.full(len(angle), np.nan), trial,
        np.zeros(len(angle), dtype=np.int64),
    ).take(keep)  # fmt: skip
    return Data(with_cells(rows), grain, sizes, change)


def _design(case: Case, rng: np.random.Generator) -> tuple[g.Array, g.Array, g.Array, g.Array, tuple[str, ...]]:
    """Angle (rad), flow (kg/s), speed (rad/s), moisture (%) and trial of each row."""
    if case.speeds == "many":
        angles, flows, speeds = (
            np.arange(40.0, 91.0, 10.0),
            np.array([1.5, 4.0, 8.0, 14.0, 21.0]),
            np.array([330.0, 400.0, 470.0]),
        )
    else:
        angles, flows, speeds = np.arange(40.0, 91.0, 5.0), np.array([1.5, 4.0, 7.0, 11.0, 15.0, 19.0, 23.0]), np.array([400.0])
    wet = [14.0, 22.0] if "moisture_dependence" in case.hidden else [15.0]
    s, f, w, t, a = np.meshgrid(speeds, flows, wet, np.arange(REPLICATES), angles, indexing="ij")
    moisture = w.ravel() if len(wet) > 1 else np.full(a.size, np.nan)
    if len(wet) == 1:
        moisture = np.full(a.size, 15.0)
    return np.radians(a.ravel()), f.ravel(), s.ravel() * g.RPM, moisture, tuple(str(int(v)) for v in t.ravel())


def _size(
    name: str,
    wanted: float,
    rng: np.random.Generator,
    rows: tuple[g.Array, g.Array, g.Array, g.Array],
    grain: g.Grain,
    base: g.Array,
) -> float:
    low, high = SIZES[name]
    if low == high:
        return high
    sign = -1.0 if low < 0.0 and rng.random() < 0.5 else 1.0
    angle, speed, flow, moisture = rows
    size = 0.3 * high
    for _ in range(4):
        changed = g.force(angle, speed, flow, moisture, grain, {name: sign * size})
        got = float(np.nanmax(np.abs(changed - base))) / float(np.nanmax(base))
        size = min(size * wanted / max(got, 1e-6), high)
    return sign * size
