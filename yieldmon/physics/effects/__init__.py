"""Named physical effects, one module each.

A module here holds one `EFFECT = Effect(...)`; that alone makes it known to the forward model, calibration, diagnosis,
configuration and docs.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache
from types import MappingProxyType

from .effect import Effect, EffectParameter

__all__ = ["Effect", "EffectParameter", "effect_parameter", "get_effect", "registry"]


@lru_cache(maxsize=1)
def registry() -> MappingProxyType[str, Effect]:
    """All effects by name, in alphabetical order."""
    found: dict[str, Effect] = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        effect = getattr(importlib.import_module(f"{__name__}.{module.name}"), "EFFECT", None)
        if isinstance(effect, Effect):
            found[effect.name] = effect
    return MappingProxyType(found)


def get_effect(name: str) -> Effect:
    """The effect of that name. Raises ValueError naming those that exist."""
    try:
        return registry()[name]
    except KeyError:
        raise ValueError(f"effect {name!r}: unknown; expected one of {', '.join(registry())}") from None


def effect_parameter(qualified_name: str) -> EffectParameter:
    """The parameter behind a name such as ``zero_offset.force_n``. Raises ValueError when there is none."""
    effect_name, _, name = qualified_name.partition(".")
    for parameter in get_effect(effect_name).parameters:
        if parameter.name == name:
            return parameter
    expected = ", ".join(p.name for p in get_effect(effect_name).parameters)
    raise ValueError(f"effect parameter {qualified_name!r}: unknown; expected one of {expected}")
