"""The public names, from `yieldmon.api`."""

from __future__ import annotations

import inspect

from yieldmon import api


def markdown() -> str:
    """Each name with its first sentence; classes and functions apart."""
    kinds: dict[str, list[str]] = {"Types": [], "Functions": [], "Values": []}
    for name in sorted(api.__all__, key=str.lower):
        value = getattr(api, name)
        if inspect.isclass(value) or not callable(value):
            kind = "Types" if inspect.isclass(value) else "Values"
            about = _sentence(value) if inspect.isclass(value) else str(value)
            kinds[kind].append(f"|`{name}`|{about}|")
        else:
            kinds["Functions"].append(f"|`{name}()`|{_sentence(value)}|")
    parts: list[str] = []
    for kind, rows in kinds.items():
        parts += [f"## {kind}", "", "|name|is|", "|---|---|", *rows, ""]
    return "\n".join(parts)


def _sentence(value: object) -> str:
    text = " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())
    first, dot, _ = text.partition(". ")
    return (first + dot).strip().replace("|", "\\|")
