"""Machines with laws of their own, and their loads of several crops. Nothing here comes from the product's model.

Grain is heaped towards a paddle's tip, slides outward with friction once the housing ends, flies with gravity and
drag, and strikes a plate with a restitution that a thick stream loses and with friction along the plate. The force acts on the
cell by a lever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon import api
from yieldmon.engine.self_calibration.load_forces import LoadForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.files.crops import crops
from yieldmon.physics.numerics import Array

FLOWS_KG_S, FURTHER_KG_S = (5.0, 15.0), (3.5, 18.0)
"""Of weighed loads and of those that are judged, of corn; of a lighter crop less, since a paddle holds a volume."""
TICKET_SD = 0.005
_SCATTER, _ZERO_N = 0.03, 0.1
"""Of a second's force, relative; and of a load's zero."""
_LANDED = 0.7
_CELLS = 32
"""Of a heap along the paddle."""
_GRAVITY = 9.81
_STEP_S, _STEPS = 0.002, 90
_TABLE_KG_S, _TABLE_SPEED = np.linspace(0.3, 26.0, 26), np.array([0.93, 1.0, 1.07])


@dataclass(frozen=True)
class Grain:
    """One crop as it is on one machine. heap: its height at the tip over its length, of a paddle that is full to the centre."""

    density_kg_m3: float
    friction: float
    restitution: float
    heap: float
    lost_at_m: float
    """Thickness of the stream at which restitution has fallen to 1/e."""
    plate_friction: float
    drag_per_m: float


@dataclass(frozen=True)
class Stranger:
    """A machine as it is, as it was measured for yieldmon, and its grain of each crop.

    built: true geometry. housing_rad: where the housing ends, after the top. bend: power of the heap's
    height along the paddle. lever: relative change of the force over the
    plate's length. cell: gain of the cell over the stated one.
    """

    built: api.Machine
    measured: api.Machine
    housing_rad: float
    bend: float
    lever: float
    cell: float
    grain: dict[str, Grain]


def draw(seed: int) -> Stranger:
    """The first of a seed's machines whose maker put the plate where the stream arrives: at least `_LANDED` of each crop."""
    random = np.random.default_rng([seed, 20261129])
    while True:
        machine = _drawn(f"stranger {seed}", random)
        grains = (machine.grain["corn"], *machine.grain.values())
        if all(_landed(machine, grain) > _LANDED for grain in grains):
            return machine


def _landed(machine: Stranger, grain: Grain) -> float:
    """Least share of the grain that strikes the plate."""
    flow = np.linspace(*FLOWS_KG_S, 4)
    speed = np.full(flow.shape, machine.built.nominal_elevator_speed_rad_s)
    return float(np.min(_force(machine, grain, flow, speed)[1]))


def _drawn(title: str, random: np.random.Generator) -> Stranger:
    """A machine: geometry measured by tape to 3 mm and by inclinometer to 2.5 deg, a cell known to 3 %.

    What a machine does to all of its crops is drawn once: heap, loss of restitution, friction of its plate; each crop scatters
    about it, and about its published properties.
    """
    shipped = api.Machine()
    measured = replace(
        shipped,
        name=title,
        paddle_length_m=random.uniform(0.15, 0.18),
        paddle_width_m=random.uniform(0.19, 0.26),
        plate_pivot_x_m=random.uniform(0.36, 0.44),
        plate_length_m=random.uniform(0.17, 0.24),
    )
    tape = random.normal(0.0, 0.003, 5)
    built = replace(
        measured,
        paddle_length_m=measured.paddle_length_m + tape[0],
        paddle_width_m=measured.paddle_width_m + tape[1],
        plate_pivot_x_m=measured.plate_pivot_x_m + tape[2],
        plate_pivot_y_m=measured.plate_pivot_y_m + tape[3],
        plate_length_m=measured.plate_length_m + tape[4],
        home_plate_angle_rad=measured.home_plate_angle_rad + np.radians(random.normal(0.0, 2.5)),
    )
    heap, lost_at_m = random.uniform(1.5, 3.5), np.exp(random.uniform(np.log(0.006), np.log(0.06)))
    on_plate, slides = random.uniform(0.0, 0.4), np.exp(random.normal(0.0, 0.15))
    grain = {}
    for name, crop in crops().items():
        grain[name] = Grain(
            density_kg_m3=crop.test_weight_kg_m3 * np.exp(random.normal(0.0, 0.08)),
            friction=float(np.clip(slides * random.normal(crop.friction, crop.friction_sd), 0.1, 0.7)),
            restitution=float(np.clip(random.normal(crop.restitution, crop.restitution_sd), 0.15, 0.8)),
            heap=heap * np.exp(random.normal(0.0, 0.12)),
            lost_at_m=lost_at_m * np.exp(random.normal(0.0, 0.25)),
            plate_friction=on_plate * np.exp(random.normal(0.0, 0.2)),
            drag_per_m=random.uniform(0.02, 0.08),
        )
    return Stranger(
        built=built,
        measured=measured,
        housing_rad=np.radians(random.uniform(-15.0, 20.0)),
        bend=random.uniform(0.7, 1.3),
        lever=random.uniform(-0.25, 0.25),
        cell=random.normal(1.0, 0.03),
        grain=grain,
    )


def force_n(machine: Stranger, crop: str, flow_kg_s: Array, elevator_speed_rad_s: Array) -> Array:
    """Mean horizontal force of a crop on a machine's plate at home, N, of arrays of one shape."""
    return _force(machine, machine.grain[crop], flow_kg_s, elevator_speed_rad_s)[0]


def _by_model(machine: Stranger, crop: str, flow_kg_s: Array, elevator_speed_rad_s: Array) -> Array:
    known, grain = crops()[crop].parameters(), machine.grain[crop]
    ratio = grain.density_kg_m3 / crops()[crop].test_weight_kg_m3
    values = {
        **known.values,
        "density": known.values["density"] * ratio,
        "friction": grain.friction,
        "restitution": grain.restitution,
    }
    angle = np.full(flow_kg_s.shape, machine.measured.home_plate_angle_rad)
    at = api.Conditions(angle, elevator_speed_rad_s, mass_flow_kg_s=flow_kg_s)
    force = api.ForwardModel(machine.measured, known.effects).force(at, values)
    return np.asarray(machine.cell * np.real(force))


def _force(machine: Stranger, grain: Grain, flow: Array, speed: Array) -> tuple[Array, Array]:
    """Mean force, N, and the share of the grain that strikes the plate."""
    built = machine.built
    outer, width = built.paddle_length_m, built.paddle_width_m
    passes = speed * built.sprocket_pitch_radius_m / np.mean(built.paddle_spacings_m)
    area = flow / passes / (grain.density_kg_m3 * width)
    # Thickness on the paddle: heap (u / outer)^bend outer, u from the heap's inner end.
    power = 1.0 + machine.bend
    deep = np.minimum((power * area / (grain.heap * outer**2)) ** (1.0 / power), 1.0) * outer
    place = (np.arange(_CELLS) + 0.5) / _CELLS
    radius = outer - deep[..., None] * (1.0 - place)
    mass = place**machine.bend / np.sum(place**machine.bend) * (flow / passes)[..., None]
    sliding, outward = _sliding(grain.friction, radius, outer)
    at, omega = machine.housing_rad + sliding, speed[..., None]
    tangential, radial = omega * outer, omega * outward
    x, y = outer * np.sin(at), outer * np.cos(at)
    vx, vy = tangential * np.cos(at) + radial * np.sin(at), -tangential * np.sin(at) + radial * np.cos(at)
    impulse, share = _impact(machine, grain, (x, y, vx, vy), (area / outer)[..., None])
    return passes * np.sum(impulse * mass, axis=-1), np.sum(share * mass, axis=-1) / mass.sum(axis=-1)


def _sliding(friction: float, radius: Array, outer: float) -> tuple[Array, Array]:
    """Angle over which grain slides from each radius to the tip, and its radial speed there over the paddle's, m."""
    slow = -friction + np.sqrt(friction**2 + 1.0)
    fast = -friction - np.sqrt(friction**2 + 1.0)
    angle = np.linspace(0.0, 4.0, 801)
    rise = (slow * np.exp(fast * angle) - fast * np.exp(slow * angle)) / (slow - fast)
    sliding = np.interp(outer / radius, rise, angle)
    by_angle = slow * fast * (np.exp(fast * sliding) - np.exp(slow * sliding)) / (slow - fast)
    return sliding, radius * by_angle


def _impact(machine: Stranger, grain: Grain, state: tuple[Array, ...], thick: Array) -> tuple[Array, Array]:
    """Horizontal impulse on the cell of a kilogram of each part of the stream, kg m/s, and its share that strikes the plate."""
    built, (x, y, vx, vy) = machine.built, state
    angle = built.home_plate_angle_rad
    along, into = (np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))
    pivot_x, pivot_y = built.plate_pivot_x_m, -built.plate_pivot_y_m
    place, normal, tangent = np.full(x.shape, np.nan), np.zeros(x.shape), np.zeros(x.shape)
    before = (x - pivot_x) * into[0] + (y - pivot_y) * into[1]
    for _ in range(_STEPS):
        drag = grain.drag_per_m * np.hypot(vx, vy)
        vx, vy = vx - _STEP_S * drag * vx, vy - _STEP_S * (drag * vy + _GRAVITY)
        x, y = x + _STEP_S * vx, y + _STEP_S * vy
        after = (x - pivot_x) * into[0] + (y - pivot_y) * into[1]
        back = np.where((before < 0.0) & (after >= 0.0), after / np.where(after > before, after - before, 1.0), np.nan)
        hits = np.isfinite(back) & np.isnan(place)
        where = (x - back * _STEP_S * vx - pivot_x) * along[0] + (y - back * _STEP_S * vy - pivot_y) * along[1]
        place = np.where(hits, where, place)
        normal = np.where(hits, vx * into[0] + vy * into[1], normal)
        tangent = np.where(hits, vx * along[0] + vy * along[1], tangent)
        before = after
    # Grain at an edge is spread by some millimetres.
    edge = 0.01
    share = np.clip(0.5 + place / edge, 0.0, 1.0) * np.clip(0.5 + (built.plate_length_m - place) / edge, 0.0, 1.0)
    restitution = grain.restitution * np.exp(-thick / grain.lost_at_m)
    across = (1.0 + restitution) * normal
    rubbed = np.sign(tangent) * np.minimum(grain.plate_friction * across, np.abs(tangent))
    lever = 1.0 + machine.lever * (place / built.plate_length_m - 0.5)
    level = (across * into[0] + rubbed * along[0]) * lever
    return np.nan_to_num(machine.cell * share * level), np.nan_to_num(share)


class Curve:
    """Force of one crop on one machine over flow and the elevator's speed, from a table. by_model: as yieldmon's model has it of
    this grain and the machine as measured."""

    def __init__(self, machine: Stranger, crop: str, *, by_model: bool) -> None:
        self._nominal = machine.built.nominal_elevator_speed_rad_s
        flow, speed = np.meshgrid(_TABLE_KG_S, self._nominal * _TABLE_SPEED, indexing="ij")
        self._ln = np.log((_by_model if by_model else force_n)(machine, crop, flow, speed))

    def __call__(self, flow_kg_s: Array, elevator_speed_rad_s: Array) -> Array:
        rows = np.array([np.interp(flow_kg_s, _TABLE_KG_S, column) for column in self._ln.T])
        at = (elevator_speed_rad_s / self._nominal - _TABLE_SPEED[0]) / (_TABLE_SPEED[1] - _TABLE_SPEED[0])
        first = np.clip(at.astype(int), 0, _TABLE_SPEED.size - 2)
        share, column = at - first, np.arange(flow_kg_s.size)
        return np.asarray(np.exp((1.0 - share) * rows[first, column] + share * rows[first + 1, column]))


def flows(crop: str, count: int, random: np.random.Generator, span_kg_s: tuple[float, float] = FLOWS_KG_S) -> Array:
    """Mean flows of loads of a crop, kg/s: even over the range, in any order."""
    low, high = np.array(span_kg_s) * min(crops()[crop].test_weight_kg_m3 / crops()["corn"].test_weight_kg_m3, 1.0)
    place = (random.permutation(count) + random.uniform(0.0, 1.0, count)) / count
    return np.asarray(low * (high / low) ** place)


def loads(
    machine: Stranger,
    crop: str,
    mean_kg_s: Sequence[float] | Array,
    first: int,
    random: np.random.Generator,
    *,
    by_model: bool = False,
) -> list[ReferenceMass]:
    """Tickets of a crop at these mean flows; their true masses are within `TICKET_SD`.

    Parameters
    ----------
    machine : Stranger
    crop : str
    mean_kg_s : sequence of float
    first : int
        Number of the first load.
    random : numpy.random.Generator
    by_model : bool
        As `Curve` has it.
    """
    curve = Curve(machine, crop, by_model=by_model)
    return [_load(machine, curve, float(mean), number, random) for number, mean in enumerate(mean_kg_s, first)]


def _load(machine: Stranger, curve: Curve, mean_kg_s: float, number: int, random: np.random.Generator) -> ReferenceMass:
    seconds = 300
    flow = mean_kg_s * np.exp(0.15 * random.standard_normal(seconds))
    speed = machine.built.nominal_elevator_speed_rad_s * (1.0 - 0.02 * flow / 25.0) * (1.0 + 0.01 * random.standard_normal())
    force = curve(flow, speed) * (1.0 + _SCATTER * random.standard_normal(seconds)) + _ZERO_N * random.standard_normal()
    # Neighbours in order of the flow, as the monitor sums up windows of like force.
    groups = np.array_split(np.argsort(flow), 30)
    mean = [np.array([column[part].mean() for part in groups]) for column in (force, speed)]
    duration = np.array([float(part.size) for part in groups])
    angle = np.full(duration.shape, machine.measured.home_plate_angle_rad)
    forces = LoadForces(duration, mean[0], angle, mean[1], np.full(duration.shape, np.nan))
    true_kg = float(flow.sum())
    ticket_kg = true_kg * (1.0 + TICKET_SD * random.standard_normal())
    start_s = 1000.0 * number
    return ReferenceMass(
        ReferenceSource.TICKET, start_s, start_s + seconds, ticket_kg, TICKET_SD * true_kg, true_kg, True, number, forces=forces
    )  # fmt: skip
