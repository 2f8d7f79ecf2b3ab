"""Yield points as GeoJSON (RFC 7946): WGS 84, longitude first."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from yieldmon import utc
from yieldmon.errors import InputError
from yieldmon.files.whole_file import scratch_for

from .points import YieldPoint


def properties(point: YieldPoint) -> dict[str, object]:
    """All but the position; time as ISO 8601 in UTC beside Unix time. Raises InputError for a position off the
    globe."""
    values = dataclasses.asdict(point)
    longitude, latitude = values.pop("longitude_deg"), values.pop("latitude_deg")
    if not (-180.0 <= longitude <= 180.0 and -90.0 <= latitude <= 90.0):
        raise InputError("position", f"is {latitude:g}, {longitude:g} deg", "latitude -90 to 90, longitude -180 to 180")
    return {"time_utc": utc.moment(point.time_s).isoformat(timespec="milliseconds"), **values}


def write(path: Path, points: Sequence[YieldPoint]) -> None:
    """One Feature a line, so that large files can be looked into."""
    with scratch_for(path) as scratch, scratch.open("w", encoding="utf-8") as stream:
        stream.write('{"type": "FeatureCollection", "features": [\n')
        for number, point in enumerate(points):
            feature = {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [point.longitude_deg, point.latitude_deg]},
                "properties": properties(point),
            }
            stream.write((",\n" if number else "") + json.dumps(feature, allow_nan=False))
        stream.write("\n]}\n")
