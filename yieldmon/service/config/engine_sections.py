"""Sections of the configuration file that are the engine's settings: their keys come from `engine.settings`."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from pydantic import create_model

from yieldmon.engine.settings import EngineSettings
from yieldmon.service.config.section import Section, keys_of


def _sections() -> dict[str, Any]:
    """Type and default of each section by name."""
    defaults, found = EngineSettings(), {}
    for each in dataclasses.fields(defaults):
        settings = getattr(defaults, each.name)
        section: type[Section] = create_model(
            type(settings).__name__, __base__=Section, __doc__=type(settings).__doc__, **keys_of(settings)
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
