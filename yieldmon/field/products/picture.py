"""The cleaned map as a PNG with a scale of colours and of metres.

Source of the file format: W3C, "Portable Network Graphics", third edition (2025).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from yieldmon.field.grid import Grid
from yieldmon.field.harvest import HarvestMap
from yieldmon.field.table import Array
from yieldmon.files import whole_file
from yieldmon.units import M_PER_FT, M_PER_MI, T_HA_PER_KG_M2, Units, UnitSystem, rounded

from . import FILES
from .report import colour_scale

WIDTH_PX, HEIGHT_PX, MARGIN_PX, FOOT_PX = 1400, 1000, 24, 70
_INK = (22, 32, 42)
_STOPS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
#: Letters of 5 by 7 dots, a number a row, the highest bit on the left.
_FONT = {
    "0": (14, 17, 19, 21, 25, 17, 14),
    "1": (4, 12, 4, 4, 4, 4, 14),
    "2": (14, 17, 1, 2, 4, 8, 31),
    "3": (31, 2, 4, 2, 1, 17, 14),
    "4": (2, 6, 10, 18, 31, 2, 2),
    "5": (31, 16, 30, 1, 1, 17, 14),
    "6": (6, 8, 16, 30, 17, 17, 14),
    "7": (31, 1, 2, 4, 8, 8, 8),
    "8": (14, 17, 17, 14, 17, 17, 14),
    "9": (14, 17, 17, 15, 1, 2, 12),
    ".": (0, 0, 0, 0, 0, 12, 12),
    "-": (0, 0, 0, 31, 0, 0, 0),
    "t": (8, 8, 28, 8, 8, 9, 6),
    "/": (1, 1, 2, 4, 8, 16, 16),
    "h": (16, 16, 22, 25, 17, 17, 17),
    "a": (0, 0, 14, 1, 15, 17, 15),
    "m": (0, 0, 26, 21, 21, 21, 21),
    "k": (16, 16, 18, 20, 24, 20, 18),
    "N": (17, 25, 21, 19, 17, 17, 17),
    "b": (16, 16, 22, 25, 17, 17, 30),
    "c": (0, 0, 14, 16, 16, 17, 14),
    "f": (6, 9, 8, 28, 8, 8, 8),
    "i": (4, 0, 12, 4, 4, 4, 14),
    "l": (12, 4, 4, 4, 4, 4, 14),
    "u": (0, 0, 17, 17, 17, 19, 13),
    ",": (0, 0, 0, 0, 12, 4, 8),
    " ": (0,) * 7,
}
LETTERS = frozenset(_FONT)
"""That can be written."""
_BAR_PX = 240.0
_DOT_PX = 3


def write(folder: Path, result: HarvestMap, grid: Grid) -> list[Path]:
    """`map.png`."""
    path = folder / FILES["picture"][0]
    whole_file.write(path, png(_picture(result)))
    return [path]


def png(pixels: np.ndarray) -> bytes:
    """pixels: shape (rows, columns, 3), uint8."""
    rows, columns, _ = pixels.shape
    lines = np.concatenate((np.zeros((rows, 1), np.uint8), pixels.reshape(rows, columns * 3)), axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines.tobytes(), 3)) + chunk(b"IEND", b"")


def colours(share: Array) -> np.ndarray:
    """RGB of 0 to 1."""
    place = np.clip(share, 0.0, 1.0) * (len(_STOPS) - 1)
    return np.stack([np.interp(place, np.arange(len(_STOPS)), _STOPS[:, band]) for band in range(3)], axis=-1).astype(np.uint8)


def _picture(result: HarvestMap) -> np.ndarray:
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    rows = np.flatnonzero(result.cleaned.kept)
    low, high = colour_scale(result)
    if len(rows):
        corners = result.ground.corners_m[rows]
        west, south = np.percentile(corners, 0, axis=(0, 1))
        east, north = np.percentile(corners, 100, axis=(0, 1))
        scale = min(
            (WIDTH_PX - 2 * MARGIN_PX) / max(east - west, 1.0), (HEIGHT_PX - 2 * MARGIN_PX - FOOT_PX) / max(north - south, 1.0)
        )
        left = (WIDTH_PX - scale * (east - west)) / 2
        share = (result.yield_kg_m2[rows] * T_HA_PER_KG_M2 - low) / (high - low)
        _fill(image, corners, colours(share), west=west, north=north, scale=scale, left=left)
        _bar(image, scale, result.units)
    _legend(image, low, high, result.units)
    return image


def _fill(image: np.ndarray, corners: Array, rgb: np.ndarray, *, west: float, north: float, scale: float, left: float) -> None:
    """Sample each swath on a lattice finer than the pixels."""
    length = np.hypot(*(corners[:, 3] - corners[:, 0]).T) * scale
    width = np.hypot(*(corners[:, 1] - corners[:, 0]).T) * scale
    along, across = (int(np.clip(np.ceil(1.6 * np.percentile(size, 90)) + 1, 2, 40)) for size in (length, width))
    for u in (np.arange(along) + 0.5) / along:
        for v in (np.arange(across) + 0.5) / across:
            back, front = (corners[:, a] * (1 - v) + corners[:, b] * v for a, b in ((0, 1), (3, 2)))
            place = back * (1 - u) + front * u
            x = (left + (place[:, 0] - west) * scale).astype(int)
            y = (MARGIN_PX + (north - place[:, 1]) * scale).astype(int)
            inside = (x >= 0) & (x < WIDTH_PX) & (y >= 0) & (y < HEIGHT_PX - FOOT_PX)
            image[y[inside], x[inside]] = rgb[inside]


def _text(image: np.ndarray, text: str, x: int, y: int) -> int:
    for letter in text:
        dots = np.array([[row >> (4 - bit) & 1 for bit in range(5)] for row in _FONT.get(letter, _FONT["-"])], bool)
        block = np.kron(dots, np.ones((_DOT_PX, _DOT_PX), bool))
        view = image[y : y + block.shape[0], x : x + block.shape[1]]
        view[block[: view.shape[0], : view.shape[1]]] = _INK
        x += 6 * _DOT_PX
    return x


def scale_words(low_t_ha: float, high_t_ha: float, units: Units) -> tuple[str, str]:
    """Both ends of the scale of colours, in the unit that people read; the unit behind the upper one."""
    unit = units.yield_unit
    low, high = (rounded(unit.of(value / T_HA_PER_KG_M2)) for value in (low_t_ha, high_t_ha))
    return low, f"{high} {unit.name}"


def bar(longest_m: float, units: Units) -> tuple[float, str]:
    """Length, m, of the longest bar of 1, 2 or 5 times a power of ten of its unit up to longest_m, and what stands beside it."""
    us = units.system is UnitSystem.US
    small, large, from_m = (("ft", M_PER_FT), ("mi", M_PER_MI), M_PER_MI) if us else (("m", 1.0), ("km", 1000.0), 1000.0)
    name, worth_m = large if longest_m >= from_m else small
    power = 10.0 ** np.floor(np.log10(longest_m / worth_m))
    count = max(step * power for step in (1, 2, 5) if step * power <= longest_m / worth_m * (1.0 + 1e-9))
    return count * worth_m, f"{count:g} {name}"


def _legend(image: np.ndarray, low: float, high: float, units: Units) -> None:
    top = HEIGHT_PX - FOOT_PX + 22
    lower, upper = scale_words(low, high, units)
    x = _text(image, lower, MARGIN_PX, top) + 8
    image[top : top + 21, x : x + 320] = colours(np.linspace(0, 1, 320))[None]
    _text(image, upper, x + 332, top)


def _bar(image: np.ndarray, scale: float, units: Units) -> None:
    length, text = bar(_BAR_PX / scale, units)
    end = WIDTH_PX - MARGIN_PX - 18 * len(text) - 12
    start, top = int(end - length * scale), HEIGHT_PX - FOOT_PX + 22
    image[top + 16 : top + 20, start:end] = _INK
    image[top + 6 : top + 20, start : start + 4] = _INK
    image[top + 6 : top + 20, end - 4 : end] = _INK
    _text(image, text, end + 12, top)
