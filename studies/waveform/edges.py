"""Whether pulses around the reference campaign's loads and plate angles bring the refused cells into the law's range."""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.waveform.fill import TABLES, Edges, Judge, left_out

CHOICES: dict[str, Edges | None] = {
    "none": None,
    "85 deg": lambda key: key[3] == 85.0 and 0.2 <= key[2] <= 1.8,
    "2.3 kg, 85 deg": lambda key: key[2] > 0.1 and key[3] >= 40.0,
    "2.3 kg, 35 and 85 deg": lambda key: key[2] > 0.1,
    "0.1 and 2.3 kg, 85 deg, from 55 deg on": lambda key: key[3] >= 55.0,
    "all": lambda key: True,
}


def report(model_error: float = 0.1) -> list[dict[str, Any]]:
    """A row for each choice of pulses that the law has seen besides; the judged cells stay those of the reference campaign."""
    rows = []
    for indexed in (True, False):
        for name, chosen in CHOICES.items():
            judge = Judge(model_error, indexed, pooled=True, edges=chosen)
            errors, stated, told = (
                np.concatenate(part) for part in zip(*(left_out(judge, *table) for table in TABLES), strict=True)
            )
            size, told = 100.0 * np.abs(errors), told.astype(bool)
            rows.append(
                {
                    "edges": name, "indexed": indexed, "published_pct": round(100.0 * float(told.mean())),
                    "published_mean_pct": round(float(size[told].mean()), 1),
                    "published_largest_pct": round(float(size[told].max()), 1),
                    "published_rms_error_over_sd": round(float(np.sqrt(np.mean((errors / stated)[told] ** 2))), 2),
                    "errors_pct": np.round(100.0 * errors, 1).tolist(),
                }
            )  # fmt: skip
    return rows
