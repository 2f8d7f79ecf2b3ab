"""Sections of the configuration file that are the engine's settings: their keys come from `engine.settings`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, get_origin, get_type_hints

from pydantic import Field, create_model

from yieldmon.engine.settings import EngineSettings
from yieldmon.service.config.section import Section
from yieldmon.setting_keys import Key


def _keys(settings: Any) -> dict[str, Any]:
    """The keys that an object of settings declares: their types and descriptions by name."""
    kinds = get_type_hints(type(settings))
    declared = {each.name: Key.of(each.metadata) for each in dataclasses.fields(settings)}
    return {name: _as_yaml(kinds[name], getattr(settings, name), key) for name, key in declared.items() if key is not None}


def _as_yaml(kind: Any, default: Any, key: Key) -> tuple[Any, Any]:
    """Type and description of a key. YAML has lists and mappings of plain values alone."""
    told: dict[str, Any] = {"description": key.meaning}
    if key.unit:
        told["json_schema_extra"] = {"unit": key.unit}
    if get_origin(kind) is tuple:
        return list[float], Field(list(default), min_length=1, max_length=key.most, **told)
    if get_origin(kind) is Mapping:
        return dict[str, Annotated[float, Field(ge=key.low, le=key.high)]], Field(default_factory=dict, **told)
    return kind, Field(default, ge=key.low, le=key.high, **told)


def _sections() -> dict[str, Any]:
    """Type and default of each section by name."""
    defaults, found = EngineSettings(), {}
    for each in dataclasses.fields(defaults):
        settings = getattr(defaults, each.name)
        section: type[Section] = create_model(
            type(settings).__name__, __base__=Section, __doc__=type(settings).__doc__, **_keys(settings)
        )
        found[each.name] = section, section()
    return found


if TYPE_CHECKING:

    class EngineSections(Section):
        """One section for each class of the engine's settings; their values in their types are in `engine_settings`."""

        inputs: Section = Section()

else:
    _SECTIONS = _sections()
    # A configuration that goes to another process names its classes by module.
    globals().update({section.__name__: section for section, _ in _SECTIONS.values()})
    EngineSections = create_model("EngineSections", __base__=Section, **_SECTIONS)


def engine_settings(document: EngineSections) -> EngineSettings:
    """The engine's settings that a document asks for."""
    settings = EngineSettings()
    sections = {}
    for each in dataclasses.fields(settings):
        keys = getattr(document, each.name).model_dump()
        values = {key: tuple(value) if isinstance(value, list) else value for key, value in keys.items()}
        sections[each.name] = dataclasses.replace(getattr(settings, each.name), **values)
    return dataclasses.replace(settings, **sections)
