"""Where a service keeps its files, by the service manager's variables."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

#: Of a socket's path, on Linux, without the zero at its end.
LONGEST_SOCKET_BYTES = 107


def state_folder(environment: Mapping[str, str]) -> Path:
    """Where a service keeps its data: systemd's StateDirectory, else the user's state folder."""
    if "STATE_DIRECTORY" in environment:
        return Path(environment["STATE_DIRECTORY"].partition(":")[0])
    home = environment.get("HOME", "/var/lib")
    return Path(environment.get("XDG_STATE_HOME") or Path(home) / ".local" / "state") / "yieldmon"


def runtime_folder(environment: Mapping[str, str]) -> Path:
    """Where a service keeps its socket: systemd's RuntimeDirectory, else the user's, else the state folder."""
    if "RUNTIME_DIRECTORY" in environment:
        return Path(environment["RUNTIME_DIRECTORY"].partition(":")[0])
    if environment.get("XDG_RUNTIME_DIR"):
        return Path(environment["XDG_RUNTIME_DIR"]) / "yieldmon"
    return state_folder(environment)


def where_sqlite_writes(path: Path) -> Path:
    """What a link to a store leads to: SQLite keeps the journal beside that, and by the link a second daemon would have a lock of
    its own. Linked folders stay as named."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path
