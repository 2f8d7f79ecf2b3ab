"""Keys of configuration files that have another name now; for one version they are still read, with a note."""

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
}


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
        Where a file has a key under both of its names.
    """
    if not isinstance(content, dict):
        return content, ()
    content, notes = dict(content), []
    for (section, former), present in FORMER_KEYS.items():
        keys = content.get(section)
        if not isinstance(keys, dict) or former not in keys:
            continue
        if present in keys:
            problem = f"is given together with {section}.{present}, its present name"
            raise InputError(f"{where}: {section}.{former}", problem, "one of them")
        content[section] = {present if key == former else key: value for key, value in keys.items()}
        notes.append(f"{where}: {section}.{former} is now called {section}.{present}; the next version reads that alone")
    return content, tuple(notes)
