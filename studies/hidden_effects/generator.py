"""Data with a known hidden effect, made without the project's forward model.

Layers of the heap are integrated along the paddle by Runge-Kutta, flown in small steps to the plate, bounced and summed. Every
effect has a form of its own here, unlike the candidates' where physics allows (exponential for rational, a logarithm for a
power, a box of directions for a Gaussian one). SI units, radians; y down, angles clockwise from +x.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

G = 9.81
RPM = 2.0 * np.pi / 60.0
LAYERS = 160
_TAU_STEPS = 240
_TAU_END = 4.2


@dataclass(frozen=True)
class Geometry:
    """The 8-tooth machine, written out again."""

    pitch_radius: float = 0.0541
    spacing: float = 0.18635
    length: float = 0.16
    width: float = 0.21
    pivot: tuple[float, float] = (0.4, -0.16)
    plate: float = 0.1887
    nominal_speed: float = 400.0 * RPM


@dataclass(frozen=True)
class Grain:
    """friction, restitution, bulk density (kg/m3), heap shape ratio."""

    friction: float
    restitution: float
    density: float
    shape: float = 2.0


Effects = Mapping[str, float]
"""Name -> size; moisture_dependence stands for its friction rate, with density and restitution following."""


def force(  # noqa: PLR0915
    angle: Array,
    speed: Array,
    flow: Array,
    moisture: Array,
    grain: Grain,
    effects: Effects,
    machine: Geometry = Geometry(),
    *,
    other_laws: bool = False,
    third_laws: bool = False,
    friction_at: Callable[[Array], Array] | None = None,
) -> Array:
    """Mean horizontal force, N, for arrays of one shape (rows,); nan where the paddles would overflow.

    other_laws: the effects in `OTHER_LAWS` act by those laws; third_laws: those in `THIRD_LAWS` by a third set, which shares no
    law with the library's. friction_at: factor on friction at a sliding speed, m/s.
    """
    size = dict(effects)
    other = frozenset(OTHER_LAWS) if other_laws else frozenset[str]()
    third = frozenset(THIRD_LAWS) if third_laws else frozenset[str]()
    wetter = moisture - 15.0
    rate = size.get("moisture_dependence", 0.0)
    sliding = size.get("speed_dependent_friction", 0.0)
    mu = grain.friction * (1.0 + rate * wetter)
    e = np.clip(grain.restitution * (1.0 - 0.5 * rate * wetter), 0.0, 1.0)
    density = grain.density * (1.0 - 0.2 * rate * wetter)
    length = machine.length - size.get("paddle_wear", 0.0)
    angle = angle + size.get("plate_angle_offset", 0.0)
    speed = speed * (1.0 - size.get("chain_slip", 0.0))
    faster = speed / machine.nominal_speed
    if "speed_dependent_friction" not in third:
        mu, sliding = mu * (1.0 + sliding * (faster - 1.0)), 0.0
    swifter = 0.5 * (faster**2 - 1.0) if "speed_dependent_shape" in third else faster - 1.0
    shape = grain.shape * (1.0 + size.get("speed_dependent_shape", 0.0) * swifter) * (1.0 + size.get("heap_shape", 0.0))
    passes = speed * machine.pitch_radius / machine.spacing
    full = 0.5 * shape * density * machine.width * length**2
    mass = flow / passes
    fill = mass / full
    if "paddle_leakage" in third:
        mass = mass * (1.0 - 0.8 * size.get("paddle_leakage", 0.0) * np.minimum(fill, 1.0) ** 1.5 / faster**2)
    elif "paddle_leakage" in other:
        mass = mass * (1.0 - size.get("paddle_leakage", 0.0) * np.maximum(fill - 0.15, 0.0))
    else:
        mass = mass * np.exp(-size.get("paddle_leakage", 0.0) * fill / faster)
    inner = _inner_radius(mass / (density * machine.width * length**2), shape)
    radius, psi, share = _layers(inner, shape)
    layer_mass = share * (density * machine.width * length**2)[:, None]
    layer_mass *= (mass / np.sum(layer_mass, axis=1))[:, None]

    pull = size.get("gravity", 0.0)
    start: Array | float = 1.5 * np.pi + size.get("release_angle", 0.0)
    if "release_angle" in third and "release_angle" in size:
        start = (1.5 * np.pi + size["release_angle"] * (0.75 + 0.5 * fill))[:, None]
    number = pull / (length * speed**2)
    outwards = 0.7 * np.ones_like(radius) if "residual_radial_speed" in third else np.sqrt(radius)
    push = size.get("residual_radial_speed", 0.0) * (radius**2 if "residual_radial_speed" in other else outwards)
    tip = (length * speed)[:, None]
    if sliding and friction_at is None:
        # Friction grows with the speed along the paddle.
        friction_at = lambda v: 1.0 + sliding * (v - 2.0) / (v + 2.0)  # noqa: E731
    tau, outward = _slide(radius, push, mu[:, None], number[:, None], start, tip, friction_at)
    theta = start + tau
    vx, vy = tip * (outward * np.cos(theta) - np.sin(theta)), tip * (outward * np.sin(theta) + np.cos(theta))
    x, y = length * np.cos(theta), length * np.sin(theta)
    parts = _as_released(
        x,
        y,
        vx,
        vy,
        size=size,
        radius=radius,
        psi=psi,
        inner=inner,
        push=push,
        tau=tau,
        speed=speed,
        tip=tip,
        start=start,
        third=third,
    )

    fan = np.sqrt(3.0) * size.get("stream_spread", 0.0) * (np.linspace(-1.0, 1.0, 15) if "stream_spread" in size else np.zeros(1))
    weights = np.full(len(fan), 1.0 / len(fan))
    if "stream_spread" in third and "stream_spread" in size:
        # A sharp middle with long tails: most grain keeps its path.
        fan = size["stream_spread"] * np.linspace(-3.0, 3.0, 25)
        weights = np.exp(-np.sqrt(2.0) * np.abs(np.linspace(-3.0, 3.0, 25)))
        weights /= weights.sum()
    momentum = np.zeros(len(mass))
    landed_mass = np.zeros(len(mass))
    for share, (px, py, wx, wy) in parts:
        for turn, weight in zip(fan, weights, strict=True):
            ux, uy = wx * np.cos(turn) - wy * np.sin(turn), wx * np.sin(turn) + wy * np.cos(turn)
            pulse, landed = _strike(
                px,
                py,
                ux,
                uy,
                radius * psi * length,
                share * layer_mass,
                angle,
                e,
                size,
                machine,
                other=other,
                third=third,
                fill=fill,
            )
            momentum += pulse * weight
            landed_mass += landed * weight
    reading = momentum * passes
    lies = np.cos(angle) if "resting_grain" in other else 0.3 + 0.9 * np.cos(angle) ** 2 if "resting_grain" in third else 1.0
    reading = reading + landed_mass * passes * G * size.get("resting_grain", 0.0) * lies
    if "cell_nonlinearity" in third:
        reading = reading / (1.0 + 40.0 * size.get("cell_nonlinearity", 0.0) * np.log1p(np.maximum(reading, 0.0) / 20.0))
    elif "cell_nonlinearity" in other:
        reading = reading - size.get("cell_nonlinearity", 0.0) * np.maximum(reading - 15.0, 0.0) * reading
    else:
        reading = _cell(reading, size)
    reading = reading + size.get("zero_offset", 0.0) + size.get("plate_buildup", 0.0) * np.cos(angle)
    return np.where(mass <= full, reading, np.nan)


def _as_released(
    x: Array, y: Array, vx: Array, vy: Array, *, size: Mapping[str, float], radius: Array, psi: Array, inner: Array, push: Array,
    tau: Array, speed: Array, tip: Array, start: Array | float, third: frozenset[str],
) -> list[tuple[Array, tuple[Array, Array, Array, Array]]]:  # fmt: skip
    """Shares of each layer with the jet (x, y, vx, vy) that they make, after the effects that keep grain from its paddle."""
    since = tau / speed[:, None]
    rise = np.zeros_like(x)
    if "stream_rise" in size:
        # From the pressure of the grain inside, which goes as the difference of the radii's squares.
        rise = size["stream_rise"] * tip * (radius**2 - inner[:, None] ** 2) / (1.0 + inner[:, None])
        if "stream_rise" in third:
            rise = 0.6 * size["stream_rise"] * tip * np.sqrt(np.maximum(radius - inner[:, None], 0.0))
    carried = (x, y - rise * since, vx, vy - rise)
    if "unpushed_layers" not in size:
        return [(np.ones_like(radius), carried)]
    # A rational share of each layer; free grain starts from the housing's edge, where the paddle leaves it behind, and is
    # drawn along by what follows: half way to the tip's speed, as a geometric mean.
    ahead = size["unpushed_layers"] * psi
    free = np.clip(0.7 * ahead, 0.0, 1.0) ** 1.5 if "unpushed_layers" in third else ahead / (1.0 + ahead)
    pull, drawn = size.get("gravity", 0.0), np.sqrt(radius)
    length = tip / speed[:, None]
    c, d = np.cos(start), np.sin(start)
    wx, wy = tip * (push * c - drawn * d), tip * (push * d + drawn * c) - rise
    px, py = length * radius * c + since * wx, length * radius * d + since * (wy + 0.5 * pull * since)
    return [(1.0 - free, carried), (free, (px, py, wx, wy + pull * since))]


def _cell(reading: Array, size: Mapping[str, float]) -> Array:
    softening = size.get("cell_nonlinearity", 0.0)
    if softening == 0.0:
        return reading
    return (1.0 - np.exp(-2.0 * softening * reading)) / (2.0 * softening)


def _inner_radius(fraction: Array, shape: Array) -> Array:
    low, high = np.zeros_like(fraction), np.ones_like(fraction)
    for _ in range(60):
        middle = 0.5 * (low + high)
        held = 0.5 * shape * (1.0 - middle) - 0.5 * middle * np.sin(shape * (1.0 - middle))
        low, high = np.where(held > fraction, middle, low), np.where(held > fraction, high, middle)
    return 0.5 * (low + high)


def _layers(inner: Array, shape: Array) -> tuple[Array, Array, Array]:
    """Radius (in paddle lengths), opening angle and mass (in density w l^2) of thin layers, finer towards the tip."""
    edges = np.linspace(0.0, 1.0, LAYERS + 1)
    depth = (1.0 - inner)[:, None]
    outer, lower = 1.0 - depth * edges[:-1] ** 2, 1.0 - depth * edges[1:] ** 2
    middle = 1.0 - depth * (0.5 * (edges[:-1] + edges[1:])) ** 2
    end = (shape * (1.0 - inner))[:, None]
    ax, bx, by = inner[:, None], np.cos(end), np.sin(end)
    # |A + t (B - A)| = rho along the heap's inner surface.
    dx, dy = bx - ax, by
    a, b = dx * dx + dy * dy, ax * dx
    t = (-b + np.sqrt(np.maximum(b * b - a * (ax * ax - middle**2), 0.0))) / a
    psi = np.arctan2(t * dy, ax + t * dx)
    return middle, psi, middle * psi * (outer - lower)


def _slide(
    rho: Array,
    push: Array,
    mu: Array,
    number: Array,
    start: Array | float,
    tip: Array,
    friction_at: Callable[[Array], Array] | None,
) -> tuple[Array, Array]:
    """Rotation at which each layer reaches the tip, and its radial speed there (in tip speeds), by Runge-Kutta in rotation.

    friction_at: factor on mu at a speed along the paddle, m/s. Layers that need more than a turn or so are given the last
    rotation; they fall short of the plate.
    """
    step = _TAU_END / _TAU_STEPS
    position, velocity = rho.copy(), push + 0.0 * rho
    tau, out = np.full(rho.shape, _TAU_END), np.full(rho.shape, np.nan)

    def rate(r: Array, v: Array, at: float) -> Array:
        theta = start + at
        here = mu if friction_at is None else mu * friction_at(np.abs(v) * tip)
        return np.asarray(r - 2.0 * here * v + number * (np.sin(theta) + here * np.cos(theta)))

    at = 0.0
    for _ in range(_TAU_STEPS):
        k1v = rate(position, velocity, at)
        k2v = rate(position + 0.5 * step * velocity, velocity + 0.5 * step * k1v, at + 0.5 * step)
        k3v = rate(position + 0.5 * step * velocity + 0.25 * step**2 * k1v, velocity + 0.5 * step * k2v, at + 0.5 * step)
        k4v = rate(position + step * velocity + 0.5 * step**2 * k2v, velocity + step * k3v, at + step)
        moved = position + step * velocity + step**2 / 6.0 * (k1v + k2v + k3v)
        faster = velocity + step / 6.0 * (k1v + 2.0 * k2v + 2.0 * k3v + k4v)
        leaves = np.isnan(out) & (moved >= 1.0)
        if np.any(leaves):
            # r(s) = r + v s + a s^2/2 = 1 within the step.
            gap, v = (1.0 - position)[leaves], velocity[leaves]
            a = 2.0 * (moved - position - step * velocity)[leaves] / step**2
            s = 2.0 * gap / (v + np.sqrt(np.maximum(v * v + 2.0 * a * gap, 0.0)) + 1e-300)
            tau[leaves] = at + s
            out[leaves] = v + a * s
        position, velocity, at = moved, faster, at + step
        if not np.any(np.isnan(out)):
            break
    return tau, np.where(np.isnan(out), 0.0, out)


def _strike(  # noqa: C901, PLR0912, PLR0915
    x: Array,
    y: Array,
    vx: Array,
    vy: Array,
    thickness: Array,
    mass: Array,
    angle: Array,
    e: Array,
    size: Mapping[str, float],
    machine: Geometry,
    *,
    other: frozenset[str],
    third: frozenset[str],
    fill: Array,
) -> tuple[Array, Array]:
    """Horizontal impulse per paddle and the mass that lands, for one direction of the fan."""
    sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
    px, py, ux, uy = x + 0.0 * vx, y + 0.0 * vy, vx.copy(), vy.copy()
    pull, drag = size.get("gravity", 0.0), size.get("air_drag", 0.0)
    reached = np.zeros(px.shape, dtype=bool)
    hx, hy = px.copy(), py.copy()
    steps = 60 if pull or drag else 1
    distance = ((py - machine.pivot[1]) * cos - (px - machine.pivot[0]) * sin) / np.maximum(ux * sin - uy * cos, 1e-9)
    dt = np.where((distance > 0.0) & (distance < 1.0), distance, 0.0) * (1.6 if steps > 1 else 1.0) / steps
    for _ in range(steps):
        speed = np.hypot(ux, uy)
        # Drag of a loose stream, a little below quadratic.
        power = 1.3 if "air_drag" in third else 1.8
        brake = drag * (speed / 6.0) ** power * 36.0 / np.maximum(speed, 1e-9)
        wx, wy = ux - dt * brake * ux, uy + dt * (pull - brake * uy)
        qx, qy = px + 0.5 * dt * (ux + wx), py + 0.5 * dt * (uy + wy)
        before = (py - machine.pivot[1]) * cos - (px - machine.pivot[0]) * sin
        after = (qy - machine.pivot[1]) * cos - (qx - machine.pivot[0]) * sin
        crosses = ~reached & (before >= 0.0) & (after <= 1e-12) & (dt > 0.0)
        part = np.where(crosses, before / np.where(before - after == 0.0, 1.0, before - after), 0.0)
        hx, hy = np.where(crosses, px + part * (qx - px), hx), np.where(crosses, py + part * (qy - py), hy)
        ux, uy = (
            np.where(reached, ux, np.where(crosses, ux + part * (wx - ux), wx)),
            np.where(reached, uy, np.where(crosses, uy + part * (wy - uy), wy)),
        )
        px, py = qx, qy
        reached |= crosses
    along = (hx - machine.pivot[0]) * cos + (hy - machine.pivot[1]) * sin
    kappa = along - machine.plate
    normal, tangent = ux * sin - uy * cos, ux * cos + uy * sin
    towards = reached & (normal > 0.0)
    width = np.maximum(np.abs(np.gradient(kappa, axis=1)), 1e-6)
    lands = np.where(towards, np.clip(0.5 - kappa / width, 0.0, 1.0), 0.0)
    lands = _caught(lands, mass, along, kappa, np.where(reached, normal, 0.0), tangent, size, other, third)
    bounce = e[:, None] + 0.0 * normal
    if "jet_shielding" in size and "jet_shielding" in third:
        thick = thickness / (thickness + 0.02)
        bounce = bounce * (1.0 - np.minimum(0.03 * size["jet_shielding"], 1.0) * thick)
    elif "jet_shielding" in size and "jet_shielding" in other:
        bounce = bounce * np.exp(-0.05 * size["jet_shielding"] * fill)[:, None]
    elif "jet_shielding" in size:
        bounce = bounce * np.exp(-0.7 * thickness * size["jet_shielding"])
    if "speed_dependent_restitution" in size and "speed_dependent_restitution" in third:
        quicker = normal / (machine.length * machine.nominal_speed) - 1.0
        bounce = np.clip(bounce * (1.0 - 0.8 * size["speed_dependent_restitution"] * quicker), 0.0, 1.0)
    elif "speed_dependent_restitution" in size and "speed_dependent_restitution" in other:
        yielding = np.maximum(normal / (machine.length * machine.nominal_speed) - 0.7, 0.0)
        bounce = bounce / (1.0 + 2.0 * size["speed_dependent_restitution"] * yielding)
    elif "speed_dependent_restitution" in size:
        nominal = machine.length * machine.nominal_speed
        bounce = bounce * np.clip(
            1.0 - size["speed_dependent_restitution"] * np.log(np.maximum(normal, 0.3) / nominal),
            0.0,
            1.0 / np.maximum(bounce, 1e-9),
        )
    if "secondary_impact" in size:
        facing = np.maximum(normal, 0.0) / np.maximum(np.hypot(normal, tangent), 1e-9)
        steep = 1.0 if "secondary_impact" in other else facing**6 if "secondary_impact" in third else facing**3
        bounce = np.minimum(bounce + size["secondary_impact"] * steep * bounce * (1.0 - bounce), 1.0)
    push = (1.0 + bounce) * normal
    rub = np.zeros_like(push)
    if "plate_friction" in size:
        cap = 2.0 / 7.0 * tangent
        sliding = size["plate_friction"] * push
        if "plate_friction" in third:
            # Sliding friction that falls with speed, blended into rolling.
            slow = sliding / (1.0 + np.abs(tangent) / 4.0)
            rub = np.sign(tangent) * slow / np.sqrt(1.0 + (slow / np.maximum(np.abs(cap), 1e-9)) ** 2)
        elif "plate_friction" in other:
            # A film that drags in proportion to the tangential speed, without a limit of rolling.
            rub = 0.7 * size["plate_friction"] * tangent
        else:
            rub = cap * np.tanh(sliding / np.maximum(np.abs(cap), 1e-9))
    weight: Array | float = 1.0
    if "lever_arm" in size:
        place = np.clip(kappa / machine.plate + 0.5, -0.5, 0.5)
        weight = 1.0 + size["lever_arm"] * np.sin(2.0 * place) if "lever_arm" in other else np.exp(size["lever_arm"] * place)
        if "lever_arm" in third:
            weight = 1.0 + size["lever_arm"] * (place + 0.8 * place**2)
    landed = mass * lands
    return np.sum(landed * weight * (push * sin + rub * cos), axis=1), np.sum(landed, axis=1)


def _caught(
    lands: Array,
    mass: Array,
    along: Array,
    kappa: Array,
    normal: Array,
    tangent: Array,
    size: Mapping[str, float],
    other: frozenset[str],
    third: frozenset[str],
) -> Array:
    """Share that lands, after the effects that act on grain near the plate's edges."""
    if "miss_capture" in size and "miss_capture" in third:
        # What passes just below the edge is drawn on to the plate, the less the further below.
        reach = np.clip(1.0 - kappa / 0.25, 0.0, 1.0)
        lands = lands + np.where(normal > 0.0, (1.0 - lands) * size["miss_capture"] * reach, 0.0)
    elif "miss_capture" in size and "miss_capture" in other:
        lands = lands + np.where(normal > 0.0, (1.0 - lands) * size["miss_capture"], 0.0)
    elif "miss_capture" in size:
        # By the part of the momentum on the plate that runs down it, fading below the edge.
        towards = normal > 0.0
        momentum = lands * mass * np.hypot(normal, tangent)
        cosine = np.where(towards, np.maximum(tangent, 0.0) / np.maximum(np.hypot(normal, tangent), 1e-9), 0.0)
        down = np.sum(momentum * cosine, axis=1, keepdims=True) / np.maximum(np.sum(momentum, axis=1, keepdims=True), 1e-12)
        reach = np.exp(-np.maximum(kappa, 0.0) / 0.6)
        lands = lands + np.where(towards, (1.0 - lands) * size["miss_capture"] * down * reach, 0.0)
    if "plate_overshoot" in size and "plate_overshoot" in third:
        lands = lands * (1.0 - np.exp(-((np.maximum(along + 0.004, 0.0) / (3.0 * size["plate_overshoot"])) ** 1.5)))
    elif "plate_overshoot" in size:
        lands = lands * (1.0 - np.exp(-np.maximum(along + 0.004, 0.0) / (2.0 * size["plate_overshoot"])))
    if "stream_rise" in size:
        lands = lands * np.clip(0.5 + along / 0.03, 0.0, 1.0)
    return lands


def outside(kind: str, reading: Array, angle: Array, speed: Array, flow: Array, size: float) -> Array:
    """Effects that no candidate describes, on a reading in the order of its rows.

    speed_resonance: gain peaks at one elevator speed. bent_bracket: the cell's bracket yields between 58 and 72 deg.
    lagging_sensor: the reading keeps a share of the row before. overfull_spill: a step of loss above a flow.
    """
    if kind == "speed_resonance":
        centre = np.median(np.unique(speed))
        return reading * (1.0 + size * np.exp(-(((speed - centre) / (0.05 * centre)) ** 2)))
    if kind == "bent_bracket":
        return reading * (1.0 - size * np.exp(-(((np.degrees(angle) - 65.0) / 6.0) ** 4)))
    if kind == "lagging_sensor":
        out = reading.copy()
        for i in range(1, len(out)):
            out[i] = (1.0 - 2.0 * size) * reading[i] + 2.0 * size * out[i - 1]
        return out
    if kind == "overfull_spill":
        return np.asarray(reading * (1.0 - size / (1.0 + np.exp(-(flow - 0.6 * flow.max()) / (0.02 * flow.max())))))
    raise ValueError(f"outside effect {kind!r}: unknown")


OTHER_LAWS = (
    "paddle_leakage", "residual_radial_speed", "resting_grain", "cell_nonlinearity", "jet_shielding", "secondary_impact",
    "speed_dependent_restitution", "plate_friction", "lever_arm", "miss_capture",
)  # fmt: skip
"""Effects with a second law: a threshold of fill or force, another power of radius, weight by the plate's slope, a gain falling
with exp(-fill), a share that does not depend on incidence or place, yielding above a speed, drag in proportion to speed."""

THIRD_LAWS = (
    "paddle_leakage", "residual_radial_speed", "resting_grain", "cell_nonlinearity", "jet_shielding", "secondary_impact",
    "speed_dependent_restitution", "plate_friction", "lever_arm", "miss_capture", "stream_spread", "air_drag",
    "speed_dependent_shape", "release_angle", "plate_overshoot", "unpushed_layers", "stream_rise", "speed_dependent_friction",
)  # fmt: skip
"""Effects with a third law: loss by fill to the power 1.5 over speed squared, one radial speed for all layers, weight borne by a
part that does not slope away, a logarithm of force, shielding that saturates with thickness, cos^6, e linear in speed, friction
that falls with speed, a quadratic lever, capture that fades below the edge, a fan with long tails, drag with speed to 1.3, a heap
by speed squared, a release that comes later with load, a stream that thins out faster than exponentially, a thresholded share of
free layers, a rise by the root of depth, friction that grows with the speed along the paddle and saturates."""

OUTSIDE = ("speed_resonance", "bent_bracket", "lagging_sensor", "overfull_spill")
