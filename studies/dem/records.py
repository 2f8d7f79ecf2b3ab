"""From per-grain records to numbers: impulses, histories, heap, release, aim, landing, and one table row. Pure functions.

The per-grain arrays are those that `worker` writes; their axes are those of `yieldmon.physics.machine` (y down).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import Throw
from yieldmon.physics.machine import RPM, Machine

Array = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]

DEFLECTED_SHARE = 0.1
"""A grain counts as deflected when its horizontal speed at the end differs from that of its free flight by this share."""
RADIAL_LAYERS = 6


def impulse_n_s(force_n: Array, time_step_s: float) -> Array:
    """Sum of force times time step along axis 0, N s."""
    total: Array = force_n.sum(axis=0) * time_step_s
    return total


def resample_force_n(force_n: Array, time_step_s: float, interval_s: float) -> Array:
    """Mean force in each interval, with the impulse kept: force_n (steps,), each value held for one time_step_s.

    The result covers the history and ends with an interval padded by zero force.
    """
    impulse = np.concatenate([[0.0], np.cumsum(force_n) * time_step_s])
    edges_in = np.arange(len(impulse)) * time_step_s
    count = max(1, math.ceil(edges_in[-1] / interval_s - 1e-9))
    edges_out = np.arange(count + 1) * interval_s
    mean: Array = np.diff(np.interp(edges_out, edges_in, impulse)) / interval_s
    return mean


@dataclass(frozen=True, slots=True)
class PlateFrame:
    """The plate as a line in the x-y plane: from its top edge along `along`, struck in the direction `inward`."""

    pivot_m: Array
    along: Array
    inward: Array
    length_m: float

    @classmethod
    def of(cls, machine: Machine, plate_angle_rad: float) -> PlateFrame:
        c, s = math.cos(plate_angle_rad), math.sin(plate_angle_rad)
        pivot = np.array([machine.plate_pivot_x_m, machine.plate_pivot_y_m])
        return cls(pivot, np.array([c, s]), np.array([s, -c]), machine.plate_length_m)


@dataclass(frozen=True, slots=True)
class Crossing:
    """Grain where it would cross the plate's plane in free fall: nan where it never does.

    place_m: from the top edge along the plate; into_m_s, along_m_s: speed into the plate and down it. All (n,).
    """

    place_m: Array
    into_m_s: Array
    along_m_s: Array


def crossing(plate: PlateFrame, position_m: Array, velocity_m_s: Array, gravity_m_s2: float) -> Crossing:
    """Where and how fast grain crosses the plate's plane in free fall from position_m, velocity_m_s: (n, >= 2)."""
    offset, velocity = position_m[:, :2] - plate.pivot_m, velocity_m_s[:, :2]
    gap, into, pull = -(offset @ plate.inward), velocity @ plate.inward, gravity_m_s2 * plate.inward[1]
    square = into**2 + 2.0 * pull * gap
    with np.errstate(invalid="ignore"):
        crosses = (gap > 0.0) & (square > 0.0) & (into + np.sqrt(square) > 0.0)
    # The root of gap = into t + pull t^2 / 2 that stays right as pull goes to 0.
    time = np.full(len(gap), np.nan)
    time[crosses] = 2.0 * gap[crosses] / (into[crosses] + np.sqrt(square[crosses]))
    along, fall = velocity @ plate.along, gravity_m_s2 * plate.along[1]
    return Crossing(offset @ plate.along + (along + 0.5 * fall * time) * time, into + pull * time, along + fall * time)


def aim(plate: PlateFrame, position_m: Array, velocity_m_s: Array, gravity_m_s2: float = 0.0) -> tuple[NDArray[np.bool_], Array]:
    """Which grains would meet the plate in free flight, and with what speed along its inward normal.

    position_m, velocity_m_s: (n, >= 2); rows with nan aim at nothing. Returns (n,) bool and (n,) m/s (0 where not aiming). With
    gravity 0 the path is the straight line of the published model (thesis 8.17-8.20).
    """
    met = crossing(plate, position_m, velocity_m_s, gravity_m_s2)
    with np.errstate(invalid="ignore"):
        hits = (met.place_m >= 0.0) & (met.place_m <= plate.length_m)
    return hits, np.where(hits, met.into_m_s, 0.0)


def arrival(throw: Throw, plate: Arrays) -> dict[str, float]:
    """Normal momentum with which the free stream crosses the plate's plane, by where, and what the plate took of it, kg m/s.

    on_plate, over_top, below_low: of the grain that crosses there. on_face, on_end: the plate's normal-only impulse into its
    face, and along it, which only contacts with its end and its edges give.
    """
    frame = PlateFrame.of(throw.machine, float(plate["plate_angle_rad"]))
    met = crossing(frame, plate["free_position_m"], plate["free_velocity_m_s"], throw.gravity_m_s2)
    momentum = np.where(np.isfinite(met.place_m), plate["mass_kg"] * met.into_m_s, 0.0)
    over, below = met.place_m < 0.0, met.place_m > frame.length_m
    normal = impulse_n_s(plate["normal_force_n"], float(plate["time_step_s"]))
    return {
        "on_plate_kg_m_s": float(momentum[~over & ~below].sum()),
        "over_top_kg_m_s": float(momentum[over].sum()),
        "below_low_kg_m_s": float(momentum[below].sum()),
        "on_face_kg_m_s": float(normal @ frame.inward),
        "on_end_kg_m_s": float(normal @ frame.along),
    }


@dataclass(frozen=True, slots=True)
class HeapShape:
    """The settled load in the paddle's frame.

    inner_radius_m (h0), reach_rad (psi_f) and shape_ratio h_f = psi_f / (1 - h0/l) of the straight line fitted to the inner
    surface; straightness_m: rms distance of the surface from that line; bulk_density_kg_m3: load over the fitted heap's volume.
    surface_m: (k, 2) points of the inner surface, along the paddle and ahead of it.
    """

    inner_radius_m: float
    reach_rad: float
    shape_ratio: float
    straightness_m: float
    bulk_density_kg_m3: float
    surface_m: Array


def heap_shape(throw: Throw, along_m: Array, ahead_m: Array, radius_m: Array) -> HeapShape:
    """Shape of a settled heap from its grain centres: along_m on the paddle, ahead_m of it, radii, all (n,).

    The surface is sampled in strips a grain wide; in each it lies at the mean of the innermost grains (one per three grain
    diameters of paddle width), less a radius. Raises ValueError when the load covers fewer than three strips.
    """
    length, width = throw.machine.paddle_length_m, throw.machine.paddle_width_m
    diameter = 2.0 * throw.grain.radius_m
    innermost = max(3, round(width / (3.0 * diameter)))
    strip = np.floor(ahead_m / diameter).astype(int)
    points = []
    for k in range(strip.max() + 1):
        inside = along_m[strip == k] - radius_m[strip == k]
        if len(inside) >= innermost:
            points.append(((k + 0.5) * diameter, float(np.sort(inside)[:innermost].mean())))
    if len(points) < 3:
        raise ValueError(f"heap of {throw.paddle_mass_kg} kg: {len(points)} strips of surface, expected at least 3")
    y, x = np.array(points).T
    slope, h0 = np.polyfit(y, x, 1)
    residual = (x - h0 - slope * y) / math.hypot(1.0, slope)
    # Where the line x = h0 + slope y meets the housing, x = l cos psi, y = l sin psi.
    amplitude, phase = math.hypot(1.0, slope), math.atan(slope)
    reach = math.acos(min(1.0, h0 / (length * amplitude))) - phase
    area = 0.5 * length**2 * reach - 0.5 * length * h0 * math.sin(reach)
    return HeapShape(
        float(h0),
        reach,
        reach / (1.0 - h0 / length),
        float(np.sqrt(np.mean(residual**2))),
        throw.paddle_mass_kg / (area * width),
        np.column_stack([x, y]),
    )


def paddle_frame(position_m: Array, paddle_angle_rad: float) -> tuple[Array, Array]:
    """Coordinates along the paddle and ahead of it, m."""
    c, s = math.cos(paddle_angle_rad), math.sin(paddle_angle_rad)
    return position_m[:, 0] * c + position_m[:, 1] * s, position_m[:, 1] * c - position_m[:, 0] * s


def direction_below_horizontal_rad(velocity_m_s: Array) -> Array:
    """Angle of the velocity below the horizontal, rad (y is down)."""
    angle: Array = np.arctan2(velocity_m_s[:, 1], velocity_m_s[:, 0])
    return angle


def layers(throw: Throw, release: Arrays, count: int = RADIAL_LAYERS) -> list[dict[str, float]]:
    """Release by radial layer: equal-number layers of the radius at which the housing let each grain go, innermost first.

    Radii as shares of the paddle length; times from the housing letting go to the crossing of the tip circle; speed as a multiple
    of tip speed; angles in deg below the horizontal.
    """
    length = throw.machine.paddle_length_m
    tip_speed = throw.elevator_speed_rad_s * length
    good = np.flatnonzero(np.isfinite(release["let_go_radius_m"]) & np.isfinite(release["free_s"]))
    if len(good) < count:
        return []
    rho = release["let_go_radius_m"][good] / length
    settled = np.hypot(release["heap_position_m"][good, 0], release["heap_position_m"][good, 1]) / length
    travel = release["tip_s"][good] - release["let_go_s"][good]
    speed = np.hypot(*release["free_velocity_m_s"][good, :2].T) / tip_speed
    angle = np.degrees(direction_below_horizontal_rad(release["free_velocity_m_s"][good]))
    lead = np.degrees(release["let_go_lead_rad"][good])
    rows = []
    for k, part in enumerate(np.array_split(np.argsort(rho, kind="stable"), count)):
        rows.append(
            {
                "layer": k,
                "grains": len(part),
                "let_go_radius_over_l": float(rho[part].mean()),
                "settled_radius_over_l": float(settled[part].mean()),
                "lead_deg": float(lead[part].mean()),
                "travel_s": float(np.median(travel[part])),
                "travel_sd_s": float(travel[part].std()),
                "speed_over_tip": float(speed[part].mean()),
                "speed_over_tip_sd": float(speed[part].std()),
                "below_horizontal_deg": float(angle[part].mean()),
                "below_horizontal_sd_deg": float(angle[part].std()),
            }
        )
    return rows


def stream_thickness_kernels(throw: Throw, position_m: Array, velocity_m_s: Array, mass_kg: Array, at_s: Array) -> float:
    """Thickness of the stream as it passes the plate's pivot, in kernel diameters of solid grain, momentum-weighted mean.

    Each grain is carried in free flight from where it came free; the stream's solid flow per unit of paddle width over its speed
    is its thickness. position_m, velocity_m_s: (n, 3), mass_kg, at_s: (n,).
    """
    good = np.isfinite(at_s) & (velocity_m_s[:, 0] > 0.5)
    arrival = at_s[good] + (throw.machine.plate_pivot_x_m - position_m[good, 0]) / velocity_m_s[good, 0]
    bin_s = 0.004
    index = np.floor((arrival - arrival.min()) / bin_s).astype(int)
    mass = np.bincount(index, weights=mass_kg[good])
    momentum = np.bincount(index, weights=mass_kg[good] * velocity_m_s[good, 0])
    filled = mass > 0.0
    speed = momentum[filled] / mass[filled]
    density = throw.grain.mass_kg / throw.grain.volume_m3
    thickness = mass[filled] / (density * throw.machine.paddle_width_m * speed * bin_s)
    return float(np.average(thickness, weights=momentum[filled]) / (2.0 * throw.grain.radius_m))


def row(throw: Throw, release: Arrays, plate: Arrays) -> dict[str, float | int | str]:
    """One row of the campaign's table: the columns of the momentum tables first, then what the grains did."""
    angle = float(plate["plate_angle_rad"])
    dt = float(plate["time_step_s"])
    frame = PlateFrame.of(throw.machine, angle)
    mass, free_at, free_v = plate["mass_kg"], plate["free_position_m"], plate["free_velocity_m_s"]
    normal, total = impulse_n_s(plate["normal_force_n"], dt), impulse_n_s(plate["total_force_n"], dt)
    along_normal = float(normal @ frame.inward)
    freed = np.isfinite(plate["free_s"])
    aims, arriving = aim(frame, free_at, free_v)
    drops, _ = aim(frame, free_at, free_v, throw.gravity_m_s2)
    aimed = float(mass @ arriving)
    touched = np.isfinite(plate["touch_s"])
    with np.errstate(invalid="ignore"):
        change = np.abs(plate["end_velocity_m_s"][:, 0] - free_v[:, 0])
        deflected = change > DEFLECTED_SHARE * np.hypot(free_v[:, 0], free_v[:, 1])
    below = np.degrees(direction_below_horizontal_rad(free_v[freed]))
    speed = np.hypot(*free_v[freed, :2].T)
    weights = mass[freed]
    n = len(mass)
    moment = float(impulse_n_s(plate["normal_moment_n_m"], dt))
    return {
        "plate_angle_deg": round(math.degrees(angle), 6),
        "paddle_mass_kg": throw.paddle_mass_kg,
        "momentum_kg_m_s": float(normal[0]),
        "momentum_total_kg_m_s": float(total[0]),
        "elevator_speed_rpm": round(throw.elevator_speed_rad_s / RPM, 6),
        "friction": throw.contact.friction,
        "trial": throw.seed,
        "restitution": throw.contact.restitution,
        "rolling_friction": throw.contact.rolling_friction,
        "kernel": throw.grain.kernel,
        "release": throw.release.kind,
        "release_angle_deg": round(math.degrees(throw.release.angle_rad), 6),
        "grains": n,
        "fraction_released": float(freed.mean()),
        "fraction_aim": float(aims.mean()),
        "fraction_aim_with_gravity": float(drops.mean()),
        "fraction_touch": float(touched.mean()),
        "fraction_aim_and_touch": float((aims & touched).mean()),
        "fraction_touch_without_aim": float((touched & ~aims).mean()),
        "fraction_deflected": float(deflected.mean()),
        "fraction_miss": float((~touched & ~deflected).mean()),
        "aimed_normal_momentum_kg_m_s": aimed,
        "impact_ratio": along_normal / aimed if aimed > 0.0 else math.nan,
        "vertical_total_kg_m_s": float(total[1]),
        "landing_place_m": moment / along_normal if along_normal else math.nan,
        "release_speed_m_s": float(np.average(speed, weights=weights)),
        "release_speed_sd_m_s": float(speed.std()),
        "release_below_horizontal_deg": float(np.average(below, weights=weights)),
        "release_below_horizontal_sd_deg": float(below.std()),
        "stream_momentum_x_kg_m_s": float(weights @ free_v[freed, 0]),
        "stream_momentum_y_kg_m_s": float(weights @ free_v[freed, 1]),
        "stream_thickness_kernels": stream_thickness_kernels(throw, free_at, free_v, mass, plate["free_s"]),
        "duration_s": len(plate["normal_force_n"]) * dt,
        "time_step_s": dt,
        "engine_version": int(plate["engine_version"]),
        "throw_key": throw.throw_key(),
    }
