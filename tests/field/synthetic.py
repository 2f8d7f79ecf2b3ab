"""Fields with known answers, written as files; shares no code with the package it judges."""

from __future__ import annotations

from pathlib import Path

import numpy as np

EARTH_M_DEG = 111_195.0


def surface(rng: np.random.Generator, size: int, smooth: float) -> np.ndarray:
    """Yield in kg/m2 on a 1 m grid: smooth patches about 1."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=(size, size)), smooth, mode="wrap")
    return 1.0 + 0.3 * noise / noise.std()


def ag_leader(
    path: Path,
    *,
    delay_s: int,
    seed: int,
    passes: int = 24,
    length_s: int = 80,
    noise: float = 0.03,
    pure_noise: bool = False,
    latitude_deg: float = 40.0,
    longitude_deg: float = -90.0,
    width_m: float = 6.0,
    speed_m_s: float = 2.0,
    turn_s: int = 12,
    smooth_m: float = 12.0,
    start_s: int = 40_000,
    round_s: int | None = None,
    last_share: float = 1.0,
    every_s: int = 1,
    always_down: bool = False,
    trickle_kg_s: float = 0.0,
) -> float:
    """Passes north and south by turns, 1 Hz; grain reaches the sensor `delay_s` later. Returns the mass in kg that was cut.

    round_s: the clock begins again after so many seconds. last_share: of the last pass's width that has a crop; the file says the
    whole. every_s: seconds of a row, of which the flow is the mean. always_down: what the file says of the header.
    trickle_kg_s: flow where nothing is cut.
    """
    rng = np.random.default_rng(seed)
    ground = surface(rng, 400, smooth_m)
    east, north, down, number = [], [], [], []
    for k in range(passes):
        along = speed_m_s * np.arange(1, length_s + 1)
        way = along if k % 2 == 0 else speed_m_s * length_s - along
        east += [k * width_m] * length_s
        north += list(way)
        down += [1] * length_s
        turn = np.arange(1, turn_s + 1) / (turn_s + 1)
        end = north[-1]
        east += list(k * width_m + turn * width_m)
        north += list(end + (1 if k % 2 == 0 else -1) * 4 * np.sin(np.pi * turn))
        down += [0] * turn_s
        number += [k + 1] * (length_s + turn_s)
    e, n, d = np.array(east), np.array(north), np.array(down)
    cut = ground[np.round(n).astype(int) % 400, np.round(e).astype(int) % 400] * width_m * speed_m_s * d
    if pure_noise:
        cut = rng.normal(12.0, 2.0, len(cut)).clip(0) * d
    cut[np.array(number) == passes] *= last_share
    flow = np.zeros(len(cut))
    if delay_s >= 0:
        flow[delay_s:] = cut[: len(cut) - delay_s]
    else:
        flow[:delay_s] = cut[-delay_s:]
    flow = np.maximum(flow + rng.normal(0, noise * 12, len(flow)) * (flow > 0), 0.0)
    flow += np.where(flow > 0, 0.0, trickle_kg_s)
    time = start_s + np.arange(len(flow))
    way = np.where(d > 0, speed_m_s, 30.0 * 0.0254)
    if every_s > 1:
        rows = np.arange(every_s - 1, len(flow), every_s)
        flow, way = (np.add.reduceat(values, rows - every_s + 1)[: len(rows)] for values in (flow, way))
        e, n, d, time, number = e[rows], n[rows], d[rows], time[rows], [number[row] for row in rows]
        flow /= every_s
    if round_s:
        time = time % round_s
    longitude = longitude_deg + e / (EARTH_M_DEG * np.cos(np.radians(latitude_deg)))
    longitude = (longitude + 180.0) % 360.0 - 180.0
    latitude = latitude_deg + n / EARTH_M_DEG
    with path.open("w", encoding="ascii") as stream:
        for k in range(len(flow)):
            stream.write(
                f"{longitude[k]:.8f},{latitude[k]:.8f},{flow[k] / 0.45359237:.4f},{time[k]},{every_s},"
                f"{way[k] / 0.0254:.3f},{width_m / 0.0254:.2f},"
                f'15.0,{33 if d[k] or always_down else 32},{number[k]},4711,"F1:north","L1:<1>","Corn"\n'
            )
    return float(flow.sum() * every_s)
