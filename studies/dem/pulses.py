"""A campaign's force histories as the pulses of a virtual combine.

`CampaignPulses` stands in for `yieldmon.plant.pulse_table.PulseTable`, so that the same virtual combine sends discrete-element
pulses over CAN.
"""

from __future__ import annotations

import csv
import gzip
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from studies.dem.job import TOP_RAD, Throw
from studies.dem.script import start_angle_rad
from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.pulse_table import QUANTILES

Array = NDArray[np.float64]
Values = Array | float
FORCE_COLUMNS = {"normal": "force_normal_n", "total": "force_total_n"}


class CampaignPulses:
    """Impulse and shape of a paddle's pulse, between the cells of one friction of a campaign.

    Linear in elevator speed, in plate angle and in the square root of the load; below the smallest load the impulse goes as the
    load. Seeds are averaged.
    """

    def __init__(self, machine: Machine, speeds_rad_s: Array, masses_kg: Array, angles_rad: Array, impulse: Array, times: Array):
        """impulse: (speeds, masses, angles) N s. times: (speeds, masses, angles, QUANTILES) s after the paddle points up."""
        self._tip_m = machine.paddle_length_m
        self.speed_range_rad_s = (float(speeds_rad_s[0]), float(speeds_rad_s[-1]))
        self.angle_range_rad = (float(angles_rad[0]), float(angles_rad[-1]))
        self.largest_mass_kg = float(masses_kg[-1])
        self._smallest_mass_kg = float(masses_kg[0])
        axes = (speeds_rad_s, np.sqrt(masses_kg), angles_rad)
        speed = speeds_rad_s[:, None, None]
        self._gain = RegularGridInterpolator(axes, impulse / (masses_kg[None, :, None] * speed * self._tip_m))
        self._turns = RegularGridInterpolator(axes, times * speed[..., None])

    @classmethod
    def load(cls, path: Path, friction: float, machine: Machine, force: str = "total", kernel: str = "sphere") -> CampaignPulses:
        """From a campaign's table of 1 kHz forces (CSV, gzipped or not); force: "normal" or "total".

        Rows that name no kernel are of spheres. Raises InputError when the friction is not in the table for that kernel or its
        cells are no full grid of speeds, loads and angles.
        """
        column = FORCE_COLUMNS[force]
        cells: dict[tuple[float, float, float], dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
        with gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else path.open(encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                if float(row["friction"]) == friction and row.get("kernel", "sphere") == kernel:
                    key = (float(row["elevator_speed_rpm"]), float(row["paddle_mass_kg"]), float(row["plate_angle_deg"]))
                    cells[key][row["trial"]].append((float(row["time_s"]), float(row[column])))
        if not cells:
            raise InputError(f"{path}: friction", f"no row at {friction:g} of kernel {kernel}", "one of the campaign's frictions")
        speeds, masses, angles = (np.array(sorted({key[i] for key in cells})) for i in range(3))
        shape = (len(speeds), len(masses), len(angles))
        impulse, times = np.empty(shape), np.empty((*shape, len(QUANTILES)))
        for place in np.ndindex(shape):
            key = (float(speeds[place[0]]), float(masses[place[1]]), float(angles[place[2]]))
            if key not in cells:
                raise InputError(str(path), f"no row at {key[0]:g} rpm, {key[1]:g} kg, {key[2]:g} deg", "a full grid")
            lead_in = (TOP_RAD - start_angle_rad(Throw(paddle_mass_kg=1.0))) / (key[0] * RPM)
            found = [_pulse(np.array(history)) for history in cells[key].values()]
            impulse[place] = np.mean([total for total, _ in found])
            times[place] = np.mean([arrivals for _, arrivals in found], axis=0) - lead_in
        return cls(machine, speeds * RPM, masses, np.radians(angles), impulse, times)

    def impulse_n_s(
        self, paddle_mass_kg: Values, plate_angle_rad: Values, speed_rad_s: Values, coordinate: Values = 0.0
    ) -> Array:
        """Horizontal impulse of one pulse, N s; arrays broadcast. Plate angles beyond the campaign's are taken at its edge."""
        mass, speed, points = self._points(paddle_mass_kg, plate_angle_rad, speed_rad_s)
        return np.asarray(self._gain(points).reshape(mass.shape) * mass * speed * self._tip_m)

    def arrival_times_s(
        self, paddle_mass_kg: Values, plate_angle_rad: Values, speed_rad_s: Values, coordinate: Values = 0.0
    ) -> Array:
        """Times after the paddle points up at which the shares QUANTILES of the impulse have arrived; last axis QUANTILES."""
        _, speed, points = self._points(paddle_mass_kg, plate_angle_rad, speed_rad_s)
        turns = self._turns(points).reshape(*speed.shape, len(QUANTILES))
        return np.asarray(turns / speed[..., None])

    def _points(self, mass: Values, angle: Values, speed: Values) -> tuple[Array, Array, Array]:
        masses, angles, speeds = np.broadcast_arrays(*(np.asarray(q, dtype=float) for q in (mass, angle, speed)))
        if masses.size and masses.max() > self.largest_mass_kg * (1.0 + 1e-9):
            raise ValueError(f"paddle_mass_kg {masses.max():.4g}, above the campaign's {self.largest_mass_kg:g}")
        root = np.sqrt(np.clip(masses, self._smallest_mass_kg, self.largest_mass_kg))
        inside = np.stack([np.clip(speeds, *self.speed_range_rad_s), root, np.clip(angles, *self.angle_range_rad)], axis=-1)
        return masses, speeds, inside


def _pulse(history: Array) -> tuple[float, Array]:
    """Impulse (N s) of a history (time of each interval's start, force) and the times of its shares QUANTILES."""
    time, force = history.T
    interval = float(np.median(np.diff(time)))
    edges = np.append(time, time[-1] + interval)
    arrived = np.maximum.accumulate(np.concatenate([[0.0], np.cumsum(force) * interval]))
    return float(force.sum() * interval), np.asarray(np.interp(QUANTILES * arrived[-1], arrived, edges))
