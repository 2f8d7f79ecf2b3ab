"""Coordinates of a file in its own system, or in one that a person names, as longitude and latitude."""

from __future__ import annotations

from typing import Any

import numpy as np

from yieldmon.errors import InputError, brief
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import Array

_WGS84 = ("EPSG:4326", "OGC:CRS84")
_LONGEST_NAME = 20
MEND = "--crs EPSG:CODE"


def mostly_degrees(x: Array, y: Array) -> bool | None:
    """Whether most of the coordinates that are known can be degrees, in either order; None where none is known."""
    known = np.isfinite(x) & np.isfinite(y)
    with np.errstate(invalid="ignore"):
        degrees = known & (np.abs(x) <= 360) & (np.abs(y) <= 180)
    return bool(2 * degrees.sum() > known.sum()) if known.any() else None


def to_degrees(
    x: Array, y: Array, crs: str | None, options: ReadOptions, where: str, mend: str = MEND
) -> tuple[Array, Array, tuple[str, ...]]:
    """Longitude and latitude, and notes.

    Parameters
    ----------
    x, y : array, shape (n,)
        In the file's system.
    crs : str or None
        The system that the file names; one that its coordinates contradict (degrees on a plane, metres on the globe) is not used.
    options : ReadOptions
        With the system that a person names.
    where : str
        Place for errors.
    mend : str
        What is expected where no system is known.

    Raises
    ------
    InputError
        Where the system is neither named nor WGS 84, or is not that of the coordinates.
    """
    degrees = mostly_degrees(x, y)
    named = crs
    notes: tuple[str, ...] = ()
    if crs and degrees is not None and degrees != _of_degrees(crs, where):
        if not options.crs:
            said = f"{np.nanmedian(x):.7g}, {np.nanmedian(y):.7g}, which {'is in' if degrees else 'is not in'} degrees"
            raise InputError(where, f"names {_name(crs, where)} and has places such as {said}", mend)
        named, notes = None, (f"its places are not of {_name(crs, where)}, which it names",)
    if not named and options.crs and (degrees is None or degrees == _of_degrees(options.crs, "--crs")):
        named = options.crs
    if not named:
        if degrees is False:
            raise InputError(where, "names no coordinate system and is not in degrees", mend)
        of_person = f"its coordinates are degrees and not of {options.crs}: they"
        return (
            x,
            y,
            (
                *notes,
                f"{of_person if options.crs else 'names no coordinate system; its coordinates'} are taken as WGS 84 degrees",
            ),
        )
    if named.upper() in _WGS84:
        return x, y, notes
    import pyproj

    longitude, latitude = pyproj.Transformer.from_crs(_system(named, where), _WGS84[0], always_xy=True).transform(x, y)
    lost = ~(np.isfinite(longitude) & np.isfinite(latitude))
    return np.where(lost, np.nan, longitude), np.where(lost, np.nan, latitude), notes


def _system(named: str, where: str) -> Any:
    """A coordinate system. Raises InputError for one that is not known."""
    import pyproj
    import pyproj.exceptions

    try:
        return pyproj.CRS.from_user_input(named)
    except pyproj.exceptions.CRSError as error:
        raise InputError(where, f"has a coordinate system that is not known: {str(error)[:80]}", MEND) from error


def _of_degrees(named: str, where: str) -> bool:
    return named.upper() in _WGS84 or bool(_system(named, where).is_geographic)


def _name(named: str, where: str) -> str:
    return named if len(named) < _LONGEST_NAME else brief(_system(named, where).name)
