"""Named physical effects, one module each.

A module here holds one `EFFECT = Effect(...)`; that alone makes it known to the forward model, calibration, diagnosis,
configuration and docs. Where one cause is written by several laws, `LAWS` has the others. Other packages add theirs by entry
points of the group `yieldmon.effects`, each naming an `Effect`.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import lru_cache
from importlib.metadata import entry_points
from types import MappingProxyType

from yieldmon.errors import InputError

from .effect import Effect, EffectParameter
from .other_monitor import OTHER_MONITOR

__all__ = ["Effect", "EffectParameter", "changes_force", "effect_parameter", "family_of", "get_effect", "laws", "registry"]


GROUP = "yieldmon.effects"
"""Entry points of other packages."""


@lru_cache(maxsize=1)
def _modules() -> tuple[str, ...]:
    return tuple(module.name for module in pkgutil.iter_modules(__path__))


@lru_cache(maxsize=128)
def _of_module(name: str) -> Effect | None:
    effect = getattr(importlib.import_module(f"{__name__}.{name}"), "EFFECT", None) if name in _modules() else None
    return effect if isinstance(effect, Effect) else None


@lru_cache(maxsize=1)
def _own() -> dict[str, Effect]:
    return {effect.name: effect for module in _modules() if (effect := _of_module(module)) is not None}


@lru_cache(maxsize=1)
def _other_laws() -> dict[str, Effect]:
    modules = (importlib.import_module(f"{__name__}.{name}") for name in _modules())
    return {law.name: law for module in modules for law in getattr(module, "LAWS", ())}


@lru_cache(maxsize=1)
def _of_others() -> dict[str, Effect]:
    from yieldmon.physics import effect_check  # the throw that it tries effects in imports this package

    found: dict[str, Effect] = {}
    for entry in entry_points(group=GROUP):
        where = f"effect plug-in {entry.name} ({entry.value})"
        try:
            effect = entry.load()
        except Exception as error:  # whatever the code of another package raises
            raise InputError(where, f"cannot be loaded: {error}", "an Effect, such as package.module:EFFECT") from error
        if not isinstance(effect, Effect):
            raise InputError(where, f"is a {type(effect).__name__}", "an Effect")
        if effect.name in _own() or effect.name in found:
            raise InputError(where, f"{effect.name} exists already", "a name of its own")
        effect_check.check(effect, where)
        found[effect.name] = effect
    return found


@lru_cache(maxsize=1)
def registry() -> MappingProxyType[str, Effect]:
    """All effects by name, in alphabetical order, including those of other packages.

    Returns
    -------
    mapping of str to Effect

    Raises
    ------
    InputError
        For a plug-in that is no effect, whose name is taken, or that could not be fitted.

    Examples
    --------
    >>> "gravity" in api.effects()
    True
    """
    return MappingProxyType(dict(sorted((_own() | _of_others()).items())))


def laws(family: str, *, unsearched: bool = False) -> tuple[str, ...]:
    """Names of the laws by which an effect may act: its own, then the others, such as `jet_shielding-by_fill`.

    unsearched: those that no diagnosis tries (`Effect.searched`) as well.
    """
    others = (law for law in _other_laws().values() if law.family == family and (unsearched or law.searched))
    return (family, *sorted(law.name for law in others))


def family_of(name: str) -> str:
    """The effect of which `name` is a law."""
    return get_effect(name).family


def get_effect(name: str) -> Effect:
    """The effect of that name, or a law's. Raises ValueError naming the effects that exist."""
    # An effect's module has its name: one is imported instead of all.
    own = _of_module(name)
    if own is not None and own.name == name:
        return own
    if name in _own():
        return _own()[name]
    if name in _other_laws():
        return _other_laws()[name]
    if not changes_force(name):
        return OTHER_MONITOR
    try:
        return registry()[name]
    except KeyError:
        raise ValueError(f"effect {name!r}: unknown; expected one of {', '.join(registry())}") from None


def changes_force(name: str) -> bool:
    """Whether what parameter sets name like an effect is one of the forward model: none is a state of weighed loads alone."""
    return name != OTHER_MONITOR.name


def effect_parameter(qualified_name: str) -> EffectParameter:
    """The parameter behind a name such as ``zero_offset.force_n``. Raises ValueError when there is none."""
    effect_name, _, name = qualified_name.partition(".")
    for parameter in get_effect(effect_name).parameters:
        if parameter.name == name:
            return parameter
    expected = ", ".join(p.name for p in get_effect(effect_name).parameters)
    raise ValueError(f"effect parameter {qualified_name!r}: unknown; expected one of {expected}")
