"""Pulse-shape files: YAML with how a dense stream arrives, and the loads, plate angles and speeds for which that is calibrated.

The range in the file is the one declaration of where the pulses' shape gives a flow; daemon, `process` and studies follow it.
"""

from __future__ import annotations

from math import degrees, radians
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.estimation.waveform.arrival_law import BEYOND_ANGLE_RAD, BEYOND_FILL, BEYOND_SPEED, TERMS, ArrivalLaw
from yieldmon.physics.machine import RPM
from yieldmon.resources import shipped

from . import strict_yaml, whole_file
from .checked import known_keys, load_mapping, number, numbers, span
from .speeds import LARGEST_SPEED_RPM

SHIPPED = "config/pulse-shape.yaml"

_RANGES = {
    "load_share": ("fills", "1", 1.0, 1e-3, 2.0),
    "plate_angle_deg": ("plate_angles_rad", "deg", radians(1.0), 0.0, 180.0),
    "elevator_speed_rpm": ("elevator_speeds_rad_s", "rpm", RPM, 1.0, LARGEST_SPEED_RPM),
}
"""Of the calibrated range: attribute of `ArrivalLaw`, unit, its size in SI, limits."""
_HEAD = f"""# How the grain of dense pulses arrives, and where that is calibrated (docs/internals/waveform.md).
# calibrated_range: load over a full paddle, plate angle, elevator speed. Beyond it by more than {BEYOND_FILL - 1.0:.0%} of load,
# {degrees(BEYOND_ANGLE_RAD):g} deg of the plate or {BEYOND_SPEED - 1.0:.0%} of speed, no flow is given by the pulses' shape.
# log_stretch, log_tail: coefficients of 1, x, c, xc, c^2, x^2, xc^2, x^2 c, r, p, xr, xp, cr, cp, rp in ln stretch and ln tail;
# 0 where not given. x: ln load_share, c: cosine of the plate angle, r and p: ln of speed and friction over the reference's.
# They hold where the configuration says waveform.shape_terms. covariance: variance, variance and covariance of both about that.
"""
_KEYS = ("source", "calibrated_range", "reference", "log_stretch", "log_tail", "covariance")


def load(path: str | Path | None = None) -> ArrivalLaw:
    """The law in a YAML file, or the shipped one. Raises InputError naming file, key, value and range."""
    path = shipped(SHIPPED) if path is None else path
    document = load_mapping(path)
    known_keys(document, f"{path}: ", _KEYS)
    for key in _KEYS[1:]:
        if key not in document:
            raise InputError(f"{path}: {key}", "missing", f"a value as in {SHIPPED}")
    reference = document["reference"]
    if not isinstance(reference, dict) or set(reference) != {"elevator_speed_rpm", "friction"}:
        raise InputError(f"{path}: reference", f"is {reference!r}", "a mapping with elevator_speed_rpm and friction")
    speed = number(reference["elevator_speed_rpm"], f"{path}: reference.elevator_speed_rpm", "rpm", 1.0, LARGEST_SPEED_RPM) * RPM
    friction = number(reference["friction"], f"{path}: reference.friction", "", 1e-3, 2.0)
    covariance = _row(document["covariance"], f"{path}: covariance", 3, 3)
    if min(covariance[:2]) < 0.0 or covariance[2] ** 2 > covariance[0] * covariance[1]:
        expected = "[variance, variance, covariance] of ln stretch and ln tail"
        raise InputError(f"{path}: covariance", f"is {document['covariance']!r}", expected)
    return ArrivalLaw(
        stretch=_row(document["log_stretch"], f"{path}: log_stretch", 1, TERMS),
        tail=_row(document["log_tail"], f"{path}: log_tail", 1, TERMS),
        covariance=(covariance[0], covariance[1], covariance[2]),
        reference=(speed, friction),
        **_ranges(document["calibrated_range"], f"{path}: calibrated_range"),
    )


def save(law: ArrivalLaw, path: str | Path, *, source: str) -> None:
    """Write a file that `load` reads back to 10 digits, of a law that has a tail; the delay is left out."""
    document: dict[str, Any] = {"source": source}
    document["calibrated_range"] = {
        key: [_rounded(v / scale) for v in getattr(law, attribute)] for key, (attribute, _, scale, *_) in _RANGES.items()
    }
    document["reference"] = {"elevator_speed_rpm": _rounded(law.reference[0] / RPM), "friction": law.reference[1]}
    document["log_stretch"] = [_rounded(v) for v in law.stretch]
    document["log_tail"] = [_rounded(v) for v in law.tail or ()]
    document["covariance"] = [_rounded(v) for v in law.covariance]
    whole_file.write(path, _HEAD + strict_yaml.dump(document), durable=True, mode=whole_file.READABLE)


def _ranges(document: Any, where: str) -> dict[str, Any]:
    if not isinstance(document, dict) or set(document) != set(_RANGES):
        raise InputError(where, f"is {document!r}", f"a mapping with {', '.join(_RANGES)}")
    found = {}
    for key, (attribute, unit, scale, least, largest) in _RANGES.items():
        low, high = span(document[key], f"{where}.{key}", unit, least, largest)
        found[attribute] = (low * scale, high * scale)
    return found


def _row(value: Any, where: str, least: int, most: int) -> tuple[float, ...]:
    return numbers(value, where, "", -100.0, 100.0, least=least, most=most)


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")
