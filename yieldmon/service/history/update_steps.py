"""The steps between updates of the parameters as plain numbers, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.estimation.self_calibration.steady_drift import Advance

_MATRICES = ("before", "covariance_before", "transition", "after", "covariance_after")


def step_document(step: CalibrationStep) -> dict[str, Any]:
    """Plain numbers for the store."""
    return {
        "from_version": step.from_version,
        "begin_s": step.begin_s,
        "end_s": step.end_s,
        "state": list(step.state),
        "widening": step.widening,
        "sweep_alone": step.sweep_alone,
        "names": list(step.names),
        "advance": {name: np.asarray(getattr(step.advance, name)).tolist() for name in _MATRICES},
    }


def step_from_document(document: Mapping[str, Any]) -> CalibrationStep | None:
    """Inverse of `step_document`; None where it makes no sense. Documents before 0.2.0 do not say whether a sweep alone
    led to it: as if not."""
    try:
        parts = {name: np.array(document["advance"][name], dtype=float) for name in _MATRICES}
        state = tuple(map(float, document["state"]))
        step = CalibrationStep(
            from_version=int(document["from_version"]),
            begin_s=float(document["begin_s"]),
            end_s=float(document["end_s"]),
            advance=Advance(**parts),
            state=state,
            widening=float(document.get("widening", 1.0)),
            sweep_alone=bool(document.get("sweep_alone", False)),
            names=tuple(map(str, document.get("names", ()))),
        )
    except (KeyError, TypeError, ValueError):
        return None
    size = len(state)
    shapes = [(size,) if parts[name].ndim == 1 else (size, size) for name in _MATRICES]
    sound = all(part.shape == shape and np.all(np.isfinite(part)) for part, shape in zip(parts.values(), shapes, strict=True))
    return step if sound and len(step.names) <= size and 1.0 <= step.widening < np.inf else None
