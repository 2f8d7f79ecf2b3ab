"""The initial RAM disk of a guest: kernel modules, what process 1 does, and what it is told."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from .machines import Machine

_INSIDE = Path(__file__).resolve().parents[1] / "vm"

_PASSED_ON = re.compile(
    r"(PATH|HOME|USER|LANG|LC_\w+|TZ|VIRTUAL_ENV|CI|(PYTHON|PYTEST_|COVERAGE_|HYPOTHESIS_|OPENBLAS_|YIELDMON_)\w*)$"
)
"""What of the caller's environment goes in. Everything else is this machine's business."""


@dataclass(frozen=True)
class Order:
    """What the guest does.

    Attributes
    ----------
    command : tuple of str
    systemd : bool
        Whether it runs under a service manager.
    interfaces : int
        Number of vcan interfaces.
    shares : tuple of Path
        Folders whose changes come out.
    """

    command: tuple[str, ...]
    systemd: bool
    interfaces: int
    shares: tuple[Path, ...]


def archive(machine: Machine, kernel: Path, order: Order) -> bytes:
    """The initial RAM disk. kernel: folder in the cache."""
    files: dict[str, tuple[int, bytes]] = {
        "init": (0o755, (_INSIDE / "init").read_bytes()),
        "run-command": (0o755, (_INSIDE / "run-command").read_bytes()),
        "bin/busybox": (0o755, (kernel / "busybox").read_bytes()),
        "order/machine": (0o644, f"{machine.name}\n".encode()),
        "order/mode": (0o644, b"systemd\n" if order.systemd else b"plain\n"),
        "order/interfaces": (0o644, f"{order.interfaces}\n".encode()),
        "order/shares": (0o644, "".join(f"{folder.resolve()}\n" for folder in order.shares).encode()),
        "order/command": (0o755, _script(machine, order.command).encode()),
    }
    for module in (kernel / "modules").iterdir():
        files[f"modules/{module.name}"] = (0o644, module.read_bytes())
    return _cpio(files)


def _script(machine: Machine, command: tuple[str, ...]) -> str:
    passed = {name: value for name, value in os.environ.items() if _PASSED_ON.match(name)}
    passed |= {**machine.guest_environment, "VCAN_VM": machine.name}
    lines = [f"export {name}={shlex.quote(value)}" for name, value in sorted(passed.items())]
    lines += [f"cd {shlex.quote(os.getcwd())} || exit 125", f"exec {shlex.join(command)}"]
    return "\n".join(lines) + "\n"


def _cpio(files: dict[str, tuple[int, bytes]]) -> bytes:
    """A cpio archive in the kernel's "newc" format (Documentation/driver-api/early-userspace/buffer-format.rst)."""
    folders = {str(parent): (0o040755, b"") for name in files for parent in Path(name).parents if str(parent) != "."}
    plain = {name: (0o100000 | mode, content) for name, (mode, content) in files.items()}
    entries = [*sorted(folders.items()), *sorted(plain.items()), ("TRAILER!!!", (0, b""))]
    written = bytearray()
    for number, (name, (mode, content)) in enumerate(entries, start=1):
        path = name.encode() + b"\0"
        fields = (number, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(path), 0)
        written += b"070701" + b"".join(b"%08X" % field for field in fields) + path
        written += bytes(-len(written) % 4) + content
        written += bytes(-len(written) % 4)
    return bytes(written)
