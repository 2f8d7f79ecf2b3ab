"""What of a new configuration a running daemon can take."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.errors import InputError
from yieldmon.service.config.configuration import Configuration

#: Sections of the configuration that a reload cannot change.
_FIXED_AT_START = ("bus", "store", "status", "network")


def at_next_start(start: Configuration, new: Configuration) -> list[str]:
    """Sections that changed since the start and are taken at the next one. Raises InputError where nothing of the new one can be
    used before."""
    for name in ("signals", "outputs"):
        if getattr(new, name) != getattr(start, name):
            raise InputError(name, "changed while the service runs", "a restart, since the bus is filtered for it")
    return [name for name in _FIXED_AT_START if getattr(new.document, name) != getattr(start.document, name)]


def usable_now(start: Configuration, new: Configuration) -> Configuration:
    """The new configuration with what is fixed at the start as it was then: a bus or a store that is opened again is the one that
    the daemon began with."""
    fixed = {name: getattr(start.document, name) for name in _FIXED_AT_START}
    return replace(
        new,
        document=new.document.model_copy(update=fixed),
        store_path=start.store_path,
        retention=start.retention,
        socket_path=start.socket_path,
        prometheus_path=start.prometheus_path,
    )
