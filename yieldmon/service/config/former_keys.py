"""Sections and keys of configuration files that have another name now; for one version they are still read, with a note."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from yieldmon.errors import InputError

#: Section, former key -> present key. A former key is read by the version after the one that renamed it, and no longer.
FORMER_KEYS: Mapping[tuple[str, str], str] = {
    ("sweep", "lying_spread"): "feedback_plausibility_flow_spread",
    ("sweep", "lying_ratio"): "feedback_plausibility_force_ratio",
    ("waveform", "teach"): "update_parameters",
    ("waveform", "teach_windows"): "update_windows",
    ("self_calibration", "anchor_error"): "reference_error",
}
#: Former section -> present section, read for as long.
FORMER_SECTIONS: Mapping[str, str] = {"anchors": "reference_masses", "learning": "self_calibration"}


def with_present_keys(content: Any, where: str) -> tuple[Any, tuple[str, ...]]:
    """The content of a configuration file under the present keys, and a note for each former one.

    Parameters
    ----------
    content
        As parsed; what is no mapping comes back as it is.
    where
        The file, for the notes and errors.

    Raises
    ------
    InputError
        Where a file has a section or a key under both of its names.
    """
    if not isinstance(content, dict):
        return content, ()
    notes = []
    for former, present in FORMER_SECTIONS.items():
        if former in content:
            content = _renamed(content, former, present, where)
            notes.append(_note(where, former, present))
    content = dict(content)
    for (section, former), present in FORMER_KEYS.items():
        keys = content.get(section)
        if not isinstance(keys, dict) or former not in keys:
            continue
        content[section] = _renamed(keys, former, present, where, f"{section}.")
        notes.append(_note(where, f"{section}.{former}", f"{section}.{present}"))
    return content, tuple(notes)


def _renamed(content: dict[Any, Any], former: str, present: str, where: str, prefix: str = "") -> dict[Any, Any]:
    """The same, in the same order, with one key renamed. Raises InputError where both are there."""
    if present in content:
        raise InputError(
            f"{where}: {prefix}{former}", f"is given together with {prefix}{present}, its present name", "one of them"
        )
    return {present if key == former else key: value for key, value in content.items()}


def _note(where: str, former: str, present: str) -> str:
    return f"{where}: {former} is now called {present}; the next version reads that alone"
