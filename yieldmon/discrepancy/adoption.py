"""Parameter files with an effect that a diagnosis has found, and the return to the former file."""

from __future__ import annotations

import hashlib
from datetime import datetime
from pathlib import Path

import numpy as np
import scipy

from yieldmon import utc
from yieldmon.errors import InputError, reading
from yieldmon.estimation import model_error
from yieldmon.estimation.fitting.identifiability import scale_tangent
from yieldmon.estimation.parameters import (
    CARRIED,
    CARRIED_FROM,
    NOT_CALIBRATED,
    SCALE,
    WEIGHED,
    CalibratedRange,
    ParameterSet,
)
from yieldmon.files import parameter_file, whole_file
from yieldmon.physics.numerics import span

from .diagnosis import Diagnosis


def adopted(diagnosis: Diagnosis, parent: ParameterSet, provenance: dict[str, str], scale_sd: float = 0.0) -> ParameterSet:
    """Parameters with the named effects, fitted to every row, as the next version of `parent`.

    scale_sd: relative standard deviation common to all loads of the table, which the fit assumes to be exact; it widens the
    covariance along (load, density, impact gain) -> (a, a, 1/a). Parameters that were fixed in the fit (shape ratio, effects
    known before) keep their uncertainty. Raises ValueError unless the verdict names an effect.
    """
    if diagnosis.verdict != "effect":
        raise ValueError(f"the verdict is {diagnosis.verdict!r}; only a named effect can be adopted")
    best = diagnosis.best
    names = tuple(p.name for p in best.parameters)
    covariance = best.covariance()
    along = np.array([scale_tangent(name, best.values[name]) for name in names])
    covariance = covariance + scale_sd**2 * np.outer(along, along)
    kept = tuple(name for name in parent.covariance_names if name in best.frame.fixed)
    cells = best.frame.cells
    passes = cells.rows.machine.passes_per_s(cells.elevator_speed_rad_s)
    flow = cells.load if cells.rows.load_name == "mass_flow_kg_s" else cells.load * passes
    moist = cells.moisture_pct[np.isfinite(cells.moisture_pct)]
    return ParameterSet(
        values=best.values,
        covariance_names=(*names, *kept),
        covariance=scipy.linalg.block_diag(covariance, parent.covariance_of(kept)) if kept else covariance,
        calibrated=CalibratedRange(
            mass_flow_kg_s=span(flow),
            plate_angle_rad=span(cells.plate_angle_rad),
            elevator_speed_rad_s=span(cells.elevator_speed_rad_s),
            moisture_pct=span(moist) if moist.size else None,
        ),
        response_unit="N" if cells.rows.si else "response",
        version=parent.version + 1,
        provenance=provenance,
        model_error=model_error.stated(best.shown_error),
    )


def adopt(
    diagnosis: Diagnosis,
    parent: ParameterSet,
    *,
    parent_path: Path,
    out: Path,
    data: tuple[str, str],
    now: datetime,
    scale_sd: float = 0.0,
) -> Path:
    """Write the next version of the parameters to `out` and a copy of the parent beside it; returns the copy's path.

    data: path and SHA-256 of the table. scale_sd: see `adopted`. Raises InputError when the verdict names no effect.
    """
    if diagnosis.verdict != "effect":
        raise InputError("--adopt", f"the verdict is {diagnosis.verdict!r}", "a named effect to adopt")
    text = parent_path.read_bytes()
    copy = parent_copy(out, parent.version)
    provenance = {
        "method": "yieldmon diagnose",
        "date": utc.text(now),
        "effects": ", ".join(diagnosis.choice.named),
        "equivalent": "; ".join(f"{s.added}: {', '.join(s.equivalent) or 'none'}" for s in diagnosis.choice.steps),
        "data": data[0],
        "data_sha256": data[1],
        "parent": str(parent_path),
        "parent_version": str(parent.version),
        "parent_sha256": hashlib.sha256(text).hexdigest(),
        "parent_copy": copy.name,
        "gap_before_rms": f"{diagnosis.before.rms:.6g}",
        "gap_after_rms": f"{diagnosis.after.rms:.6g}",
        "gap_before_f": f"{diagnosis.before.lack_of_fit_f:.6g}",
        "gap_after_f": f"{diagnosis.after.lack_of_fit_f:.6g}",
        "seed": str(diagnosis.options.seed),
    }
    # Adoption does not change the flow at home. Sweeps do not determine the scale, unlike the loads of a table.
    if parent.is_weighed:
        provenance[SCALE] = WEIGHED
    elif parent.scale_error > 0.0 and scale_sd > 0.0:
        provenance |= {SCALE: CARRIED, CARRIED_FROM: parent.carried_from} if parent.carried_from else {SCALE: NOT_CALIBRATED}
    if "crop" in parent.provenance:
        provenance["crop"] = parent.provenance["crop"]
    if diagnosis.held_out is not None and diagnosis.held_out.closed_pct is not None:
        provenance["held_out_closed_pct"] = f"{diagnosis.held_out.closed_pct:.4g}"
    _replace(copy, text)
    parameter_file.save(adopted(diagnosis, parent, provenance, scale_sd), out)
    return copy


def parent_copy(out: Path, version: int) -> Path:
    """Path at which `adopt` keeps a copy of the parent of this version, when it writes to `out`."""
    return out.with_name(f"{out.stem}.v{version}.parent{out.suffix}")


def rollback(path: Path) -> int:
    """Restore the parent of an adopted parameter file and keep the adopted file beside it; returns the parent's version.

    Raises InputError if the file was not adopted here, or the parent's copy is missing or changed.
    """
    current = parameter_file.load(path)
    name, digest = current.provenance.get("parent_copy"), current.provenance.get("parent_sha256")
    if name is None or digest is None:
        raise InputError(f"{path}: provenance", "names no parent", "a file written by diagnose --adopt")
    if Path(name).name != name or name in ("", ".", "..") or "\0" in name:
        raise InputError(f"{path}: provenance.parent_copy", f"is {name[:80]!r}", "the name of a file in the same folder")
    copy = path.with_name(name)
    with reading(copy, "the parent's copy, beside the adopted file"):
        text = copy.read_bytes()
    if hashlib.sha256(text).hexdigest() != digest:
        raise InputError(str(copy), "is not the parent that was replaced", f"SHA-256 {digest}")
    parent = parameter_file.load(copy)
    _replace(path.with_name(f"{path.stem}.v{current.version}.rolled-back{path.suffix}"), path.read_bytes())
    _replace(path, text)
    return parent.version


def _replace(path: Path, content: bytes) -> None:
    whole_file.write(path, content, durable=True, mode=whole_file.READABLE)
