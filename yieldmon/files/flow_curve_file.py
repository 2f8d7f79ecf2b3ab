"""Files of a flow curve: YAML with the estimator's name, its coefficients or points, their deviation, range and provenance."""

from __future__ import annotations

from math import degrees, radians
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.estimation.flow_curve import AlphaBeta, FlowCurve, LookUpTable, TableColumn
from yieldmon.files.calibrated_range import calibrated_document, calibrated_range
from yieldmon.physics.machine import RPM

from . import strict_yaml, whole_file
from .checked import known_format, known_keys, load_mapping, mapping, number, numbers, texts
from .speeds import LARGEST_SPEED_RPM, LEAST_SPEED_RPM

FORMAT = 1
_LAWS = {
    AlphaBeta.kind: ("plate_angle_deg", "alpha", "beta"),
    LookUpTable.kind: ("elevator_speed_rpm", "columns"),
}
_KEYS = (
    "format", "estimator", "relative_std_dev", "exponent_std_dev", "about_kg_s", "calibrated_range", "provenance",
)  # fmt: skip
_HEAD = {
    AlphaBeta.kind: "# Mass flow (kg/s) = alpha x + beta x^2, x = mean force (N) / elevator speed (rad/s).\n",
    LookUpTable.kind: "# Mass flow by mean force at elevator_speed_rpm, a column for each plate angle.\n",
}


def load(path: str | Path) -> FlowCurve:
    """The curve in a YAML file. Raises InputError naming file, key, value and what was expected."""
    document = load_mapping(path)
    if "estimator" not in document and "friction" in document:
        raise InputError(str(path), "is a parameter file", "a curve that `calibrate --estimator` has written")
    return from_document(document, str(path))


def from_document(document: Any, where: str) -> FlowCurve:
    """The curve in the mapping of such a file. Raises InputError as `load`."""
    if not isinstance(document, dict):
        raise InputError(where, f"is {document!r}", "a mapping")
    kind = document.get("estimator")
    if not isinstance(kind, str) or kind not in _LAWS:
        raise InputError(f"{where}: estimator", f"is {kind!r}", f"one of {', '.join(_LAWS)}")
    known_keys(document, f"{where}: ", (*_KEYS, *_LAWS[kind]))
    known_format(document, FORMAT, where)
    provenance = texts(document.get("provenance"), f"{where}: provenance")
    law = _alpha_beta(document, where) if kind == AlphaBeta.kind else _table(document, where)
    return FlowCurve(
        law,
        number(document.get("relative_std_dev"), f"{where}: relative_std_dev", "", 0.0, 10.0),
        calibrated_range(mapping(document, "calibrated_range", where), where),
        provenance,
        number(document.get("exponent_std_dev", 0.0), f"{where}: exponent_std_dev", "", 0.0, 10.0),
        number(document.get("about_kg_s", 10.0), f"{where}: about_kg_s", "kg/s", 1e-6, 1e6),
    )


def to_document(curve: FlowCurve) -> dict[str, Any]:
    """The mapping that `from_document` reads back to an equal curve."""
    law = curve.law
    document: dict[str, Any] = {"format": FORMAT, "estimator": law.kind}
    if isinstance(law, AlphaBeta):
        document |= {"plate_angle_deg": _round(degrees(law.plate_angle_rad)), "alpha": law.alpha, "beta": law.beta}
    else:
        document["elevator_speed_rpm"] = _round(law.elevator_speed_rad_s / RPM)
        document["columns"] = [
            {
                "plate_angle_deg": _round(degrees(column.plate_angle_rad)),
                "force_n": list(column.force_n),
                "mass_flow_kg_s": list(column.mass_flow_kg_s),
            }
            for column in law.columns
        ]
    document["relative_std_dev"] = curve.relative_std_dev
    if curve.exponent_std_dev:
        document |= {"exponent_std_dev": curve.exponent_std_dev, "about_kg_s": curve.about_kg_s}
    document["calibrated_range"] = calibrated_document(curve.calibrated)
    document["provenance"] = dict(curve.provenance)
    return document


def save(curve: FlowCurve, path: str | Path) -> None:
    """Write the file whole or not at all. Raises InputError or OSError as `whole_file.scratch_for`."""
    text = _HEAD[curve.law.kind] + strict_yaml.dump(to_document(curve))
    whole_file.write(path, text, durable=True, mode=whole_file.READABLE)


def _round(value: float) -> float:
    return round(value, 10)


def _alpha_beta(document: dict[str, Any], where: str) -> AlphaBeta:
    alpha = number(document.get("alpha"), f"{where}: alpha", "kg/s for each N s", 1e-9, 1e9)
    beta = number(document.get("beta"), f"{where}: beta", "kg/s for each (N s)^2", -1e9, 1e9)
    return AlphaBeta(alpha, beta, _angle(document, where))


def _table(document: dict[str, Any], where: str) -> LookUpTable:
    speed = (
        number(document.get("elevator_speed_rpm"), f"{where}: elevator_speed_rpm", "rpm", LEAST_SPEED_RPM, LARGEST_SPEED_RPM)
        * RPM
    )
    entries = document.get("columns")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{where}: columns", f"is {entries!r}", "a list with a column for each plate angle")
    columns = []
    for i, entry in enumerate(entries):
        place = f"{where}: columns[{i}]"
        if not isinstance(entry, dict) or set(entry) != {"plate_angle_deg", "force_n", "mass_flow_kg_s"}:
            raise InputError(place, f"is {str(entry)[:60]}", "a mapping of plate_angle_deg, force_n and mass_flow_kg_s")
        force_n = numbers(entry["force_n"], f"{place}.force_n", "N", 0.0, 1e6)
        flow_kg_s = numbers(entry["mass_flow_kg_s"], f"{place}.mass_flow_kg_s", "kg/s", 0.0, 1e6)
        angle_rad = _angle(entry, place)
        try:
            columns.append(TableColumn(angle_rad, force_n, flow_kg_s))
        except ValueError as error:
            raise InputError(place, str(error)) from error
    try:
        return LookUpTable(speed, tuple(columns))
    except ValueError as error:
        raise InputError(f"{where}: columns", str(error)) from error


def _angle(document: dict[str, Any], where: str) -> float:
    return radians(number(document.get("plate_angle_deg"), f"{where}: plate_angle_deg", "deg", 1.0, 179.0))
