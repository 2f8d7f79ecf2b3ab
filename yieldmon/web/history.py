"""What the store says of days, loads, sweeps and parameters, read beside the daemon that writes it.

Days are summed up once and then carried on, so a page costs what came since the last one. They are summed by SQLite, which leaves
out values that no second has; rows are not held against their checksums here, as `yieldmon export` and `map` do.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from math import inf
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from yieldmon.errors import InputError, reason
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.logs import sweep_table
from yieldmon.service.logs.recorded import last_parameters, opened, ticket_table
from yieldmon.service.storage.empty_loads import empty_loads, without_empty
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_file import read_only

MOST_POINTS = 500_000
_CHUNK = 100_000
_SWEEPS, _FAULTS, _VERSIONS, _RESIDUAL_SWEEPS = 200, 100, 500, 50
_SAME_SECOND_S = 0.5
_BUDGET_SINCE = 5
"""Schema version from which on seconds have the standard deviation of the load."""

_BY_DAY = """
SELECT date(time_s, 'unixepoch', 'localtime') AS day, min(number), max(number), sum(mass_kg),
    sum(CASE WHEN mass_flow_kg_s > 0 THEN duration_s ELSE 0 END),
    sum(CASE WHEN moisture_pct IS NOT NULL THEN mass_kg * moisture_pct ELSE 0 END),
    sum(CASE WHEN moisture_pct IS NOT NULL THEN mass_kg ELSE 0 END), count(latitude_deg)
FROM second WHERE number > ? AND number <= ? AND mass_kg BETWEEN 0 AND 1000 AND time_s BETWEEN 0 AND 1e11 GROUP BY day
"""
_LOAD_STD_DEV = """
SELECT load_number, load_std_dev_kg, max(number) FROM second WHERE number > ? AND number <= ? GROUP BY load_number
"""
_PLACES = """
SELECT number, time_s, latitude_deg, longitude_deg, mass_flow_kg_s, load_number FROM second
WHERE number BETWEEN ? AND ? AND (latitude_deg IS NULL OR latitude_deg BETWEEN -85 AND 85)
    AND (longitude_deg IS NULL OR longitude_deg BETWEEN -180 AND 180) AND {condition}
ORDER BY number DESC LIMIT ?
"""
_PLACE_COLUMNS = 6


@dataclass
class _Day:
    first: int
    last: int
    mass_kg: float = 0.0
    harvesting_s: float = 0.0
    moisture_kg_pct: float = 0.0
    moisture_kg: float = 0.0
    points: int = 0

    def document(self, day: str) -> dict[str, Any]:
        return {
            "day": day,
            "mass_kg": self.mass_kg,
            "harvesting_s": self.harvesting_s,
            "mean_flow_kg_s": self.mass_kg / self.harvesting_s if self.harvesting_s else None,
            "moisture_pct": self.moisture_kg_pct / self.moisture_kg if self.moisture_kg else None,
            "points": self.points,
        }


@dataclass
class _Sums:
    """Of one store as far as it was read."""

    identity: tuple[int, int] = (0, 0)
    upto: int = 0
    days: dict[str, _Day] = field(default_factory=dict)
    load_std_dev_kg: dict[int, float] = field(default_factory=dict)
    places: Array = field(default_factory=lambda: np.empty((_PLACE_COLUMNS, 0)))
    """The columns of _PLACES, of the newest MOST_POINTS seconds up to places_upto, by number."""
    places_from: int = 0
    places_upto: int = 0


class History:
    """Reads one store; may be called from any thread, by one at a time."""

    def __init__(self, flow_delay_s: float) -> None:
        """flow_delay_s: how long after the header cut it grain is measured."""
        self._flow_delay_s = flow_delay_s
        self._lock = Lock()
        self._sums = _Sums()

    def document(self, path: Path) -> dict[str, Any]:
        """Days, loads, sweeps, parameters, faults and tickets of a store.

        Raises
        ------
        InputError
            When it cannot be read.
        """
        with self._lock, _problems(path):
            self._sum_up(path)
            with opened(path) as store:
                empty = empty_loads(store.loads())
                loads = without_empty(store.corrected_loads(), empty)
                for load in loads:
                    # Of a store that kept it with the seconds alone.
                    load["std_dev_kg"] = load["std_dev_kg"] or self._sums.load_std_dev_kg.get(load["number"])
                return {
                    "days": [day.document(name) for name, day in sorted(self._sums.days.items(), reverse=True)],
                    "loads": loads[::-1],
                    "empty_loads": empty,
                    "sweeps": [asdict(sweep) for sweep in reversed(store.sweeps(_SWEEPS))],
                    "parameters": _parameters(store, path),
                    "faults": [asdict(fault) for fault in reversed(store.faults(_FAULTS))],
                    "tickets": ticket_table(store)[::-1],
                }

    def points(self, path: Path, day: str = "", load: int | None = None) -> bytes:
        """Where grain was cut and how much flowed, the flow of each second moved back to the ground it came from.

        Parameters
        ----------
        path : Path
            The store.
        day : str
            A day as `document` names it, "today" for that of the newest second; "" for all.
        load : int or None
            One load only.

        Returns
        -------
        bytes
            Little-endian: count (uint32) and number of the last second read (uint32), then count longitudes and count latitudes
            (int32, 1e-7 deg) and count flows (float32, kg/s). The newest MOST_POINTS where there are more.

        Raises
        ------
        InputError
            When the store cannot be read.
        """
        with self._lock, _problems(path):
            self._sum_up(path)
            days = self._sums.days
            if day == "today":
                # A clock that was ahead for a while has left days that are to come.
                day = max(days, key=lambda name: days[name].last, default="")
            chosen = days.get(day)
            first, last = (chosen.first, chosen.last) if chosen is not None else (0, 0 if day else 2**62)
            with closing(read_only(path)) as database:
                self._carry_places_on(database)
                places = self._places(database, first, last, load)
        return self._packed(places)

    def prepare(self, path: Path) -> None:
        """Read what there is of a store, so that the first page does not wait for it.

        Raises
        ------
        InputError
            When it cannot be read.
        """
        with self._lock, _problems(path):
            self._sum_up(path)
            with closing(read_only(path)) as database:
                self._carry_places_on(database)

    def _carry_places_on(self, database: sqlite3.Connection) -> None:
        sums = self._sums
        begin = max(sums.places_upto, sums.upto - MOST_POINTS)
        if begin > sums.places_upto:
            sums.places, sums.places_from = np.empty((_PLACE_COLUMNS, 0)), begin + 1
        parts = [sums.places]
        for low in range(begin, sums.upto, _CHUNK):
            query = _PLACES.format(condition="1")
            parts.append(_columns(database.execute(query, (low + 1, min(low + _CHUNK, sums.upto), _CHUNK)).fetchall()))
        if len(parts) > 1:
            whole = np.concatenate(parts, axis=1)
            if whole.shape[1] > MOST_POINTS:
                whole = whole[:, -MOST_POINTS:].copy()
                sums.places_from = int(whole[0, 0])
            sums.places, sums.places_upto = whole, sums.upto

    def _places(self, database: sqlite3.Connection, first: int, last: int, load: int | None) -> Array:
        """Seconds of first to last (of a load), from those that are kept where these reach back so far."""
        end_s = inf
        if load is not None:
            # Grain between loads carries the number of the one before, as `storage.load_ends` has it.
            ended = database.execute("SELECT ended_s FROM load WHERE number = ?", (load,)).fetchone()
            end_s = inf if ended is None or ended[0] is None else ended[0]
        oldest = max(first, database.execute("SELECT min(number) FROM second").fetchone()[0] or 0)
        if oldest < self._sums.places_from:
            condition, values = ("load_number = ? AND time_s <= ?", (load, end_s)) if load is not None else ("1", ())
            query = _PLACES.format(condition=condition)
            return _columns(database.execute(query, (first, last, *values, MOST_POINTS)).fetchall())
        places = self._sums.places
        low, high = np.searchsorted(places[0], [oldest, last + 0.5])
        chosen = places[:, low:high]
        return chosen if load is None else chosen[:, (chosen[5] == load) & (chosen[1] <= end_s)]

    def _packed(self, places: Array) -> bytes:
        number, time_s, latitude, longitude, flow, _ = places
        order = np.argsort(time_s, kind="stable")
        at = np.searchsorted(time_s[order], time_s + self._flow_delay_s - _SAME_SECOND_S)
        later = order[np.minimum(at, max(0, len(order) - 1))] if len(order) else order
        moved = np.abs(time_s[later] - time_s - self._flow_delay_s) <= _SAME_SECOND_S
        keep = moved & np.isfinite(latitude) & np.isfinite(longitude) & (flow[later] > 0.0)
        degrees = [np.round(column[keep] * 1e7).astype("<i4").tobytes() for column in (longitude, latitude)]
        last = int(number[-1]) if len(number) else 0
        flows = flow[later][keep].astype("<f4").tobytes()
        return b"".join((struct.pack("<II", int(keep.sum()), last & 0xFFFFFFFF), *degrees, flows))

    def _sum_up(self, path: Path) -> None:
        found = path.stat()
        if self._sums.identity != (found.st_dev, found.st_ino):
            self._sums = _Sums((found.st_dev, found.st_ino))
        sums = self._sums
        with closing(read_only(path)) as database:
            first, last = database.execute("SELECT min(number), max(number) FROM second").fetchone()
            if last is None or last < sums.upto:
                self._sums = sums = _Sums(sums.identity)
            if last is None:
                return
            # Days of which retention has left nothing.
            for day in [day for day, part in sums.days.items() if part.last < first]:
                del sums.days[day]
            version = database.execute("PRAGMA user_version").fetchone()[0]
            for low in range(max(sums.upto, first - 1), last, _CHUNK):
                self._sum_up_chunk(database, low, min(low + _CHUNK, last), budget=version >= _BUDGET_SINCE)

    def _sum_up_chunk(self, database: sqlite3.Connection, low: int, high: int, *, budget: bool) -> None:
        sums = self._sums
        for name, first, last, mass, harvesting, moist, moist_kg, points in database.execute(_BY_DAY, (low, high)):
            day = sums.days.setdefault(name, _Day(first, last))
            day.first, day.last = min(day.first, first), max(day.last, last)
            day.mass_kg += mass
            day.harvesting_s += harvesting
            day.moisture_kg_pct += moist
            day.moisture_kg += moist_kg
            day.points += points
        if budget:
            # With max(), SQLite takes the other columns from the row that has it.
            for load, std_dev_kg, _ in database.execute(_LOAD_STD_DEV, (low, high)):
                if std_dev_kg is not None:
                    sums.load_std_dev_kg[load] = std_dev_kg
        sums.upto = high

    def residuals(self, path: Path, machine: Machine) -> dict[str, Any]:
        """What the last sweeps measured against what the model with the parameters in use says, by plate angle and flow.

        The flow at each angle is what the parameters make of the force at home around it, so at home the residual is 0 by itself.

        Parameters
        ----------
        path : Path
            The store.
        machine : Machine
            The machine it was measured on.

        Returns
        -------
        dict
            ``sweeps`` (how many), ``cells``: ``plate_angle_deg``, ``mass_flow_kg_s``, ``residual_pct``, ``visits``, and
            ``std_dev_pct`` of the mean.

        Raises
        ------
        InputError
            When the store cannot be read, or its sweeps do not say enough.
        """
        with self._lock, _problems(path):
            parameters = last_parameters(path)
            found = sweep_table.read(path, machine, parameters, _RESIDUAL_SWEEPS)
        columns = found.table.columns
        angle, flow, force, sigma, moisture = (
            np.asarray(columns[name]) for name in ("plate_angle_deg", "mass_flow_kg_s", "force_n", "sigma", "moisture_pct")
        )
        conditions = Conditions(
            np.radians(angle), np.asarray(columns["elevator_speed_rpm"]) * RPM, mass_flow_kg_s=flow, moisture_pct=moisture
        )
        model = ForwardModel(machine, parameters.effects)
        predicted = np.real(np.asarray(model.force(conditions, parameters.values, overfull="nan")))
        residual_pct, noise_pct = 100.0 * (force - predicted) / predicted, 100.0 * sigma / predicted
        cells = []
        for key in sorted(set(zip(angle.tolist(), flow.tolist(), strict=True))):
            here = (angle == key[0]) & (flow == key[1]) & np.isfinite(residual_pct)
            count = int(here.sum())
            if count:
                cells.append(
                    {
                        "plate_angle_deg": key[0], "mass_flow_kg_s": key[1], "residual_pct": float(residual_pct[here].mean()),
                        "std_dev_pct": float(np.sqrt((noise_pct[here] ** 2).sum()) / count), "visits": count,
                    }
                )  # fmt: skip
        return {"sweeps": found.sweeps, "parameter_version": parameters.version, "cells": cells}


def _columns(newest_first: list[tuple[float | None, ...]]) -> Array:
    return np.ascontiguousarray(np.array(newest_first[::-1], dtype=float).reshape(-1, _PLACE_COLUMNS).T)


def _parameters(store: Store, path: Path) -> list[dict[str, Any]]:
    """Each version with the standard deviation of each of its values, in order."""
    out = []
    for version in store.parameter_versions()[-_VERSIONS:]:
        known = parameter_file.from_document(version.document, str(path))
        values = {
            name: {"value": float(value), "std_dev": float(known.standard_deviation(name))}
            for name, value in known.values.items()
        }
        when = {"version": version.version, "time_s": version.time_s, "origin": version.origin}
        out.append({**when, "crop": known.provenance.get("crop"), "values": values})
    return out


@contextmanager
def _problems(path: Path) -> Iterator[None]:
    """Whatever is wrong with the store becomes one line."""
    try:
        yield
    except InputError:
        raise
    except (sqlite3.Error, OSError, ValueError) as error:
        raise InputError(str(path), reason(error), "a daemon's store") from error
