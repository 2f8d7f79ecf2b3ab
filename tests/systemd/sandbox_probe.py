"""Stands in for the daemon under the shipped unit: reports what the sandbox lets it do, and speaks for itself on the bus.

Frames that it sends: STARTED and RELOADED, each with its process id. It feeds the watchdog while its loop goes round.
Standard library only, so that it starts quickly.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import mmap
import os
import signal
import socket
import struct
import sys
from collections.abc import Callable
from pathlib import Path

STARTED = 0x700
RELOADED = 0x701
#: What a configuration holds that cannot be used.
WRONG = "wrong"


def main() -> int:
    verb, *_, configuration = sys.argv[1:]
    refused = WRONG in Path(configuration).read_text(encoding="utf-8")
    if refused or verb == "check-config":
        print(f"{configuration}: {WRONG}" if refused else "ok", file=sys.stderr)
        return 2 if refused else 0
    report = Path(os.environ["STATE_DIRECTORY"], "sandbox.json")
    report.write_text(json.dumps(attempts()), encoding="utf-8")
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind(("can0",))
        bus.settimeout(1.0)
        signal.signal(signal.SIGHUP, lambda *_: tell(bus, RELOADED))
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        notify("READY=1")
        tell(bus, STARTED)
        while True:
            # Silence, or the interface is gone: the service manager decides what becomes of this process.
            with contextlib.suppress(OSError):
                bus.recv(16)
            notify("WATCHDOG=1")


def notify(text: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(text.encode(), os.environ["NOTIFY_SOCKET"])


def tell(bus: socket.socket, identifier: int) -> None:
    bus.send(struct.pack("=IB3x8s", identifier, 8, struct.pack("<Q", os.getpid())))


def attempts() -> dict[str, str]:
    """What was tried -> "done" or the error's name."""
    return {name: outcome(action) for name, action in ACTIONS.items()}


def outcome(action: Callable[[], object]) -> str:
    try:
        action()
    except OSError as error:
        return type(error).__name__
    return "done"


def open_socket(family: int, kind: int = socket.SOCK_DGRAM, protocol: int = 0) -> Callable[[], object]:
    return lambda: socket.socket(family, kind, protocol).close()


def write_to(folder: str) -> Callable[[], object]:
    return lambda: Path(folder, "probe").write_text("x", encoding="utf-8")


def system_call(number: int, *arguments: int) -> Callable[[], object]:
    def call() -> None:
        if ctypes.CDLL(None, use_errno=True).syscall(number, *arguments) < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    return call


def capabilities() -> None:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    held = {line.split(":")[0]: int(line.split()[1], 16) for line in status.splitlines() if line.startswith("Cap")}
    if any(held.values()):
        return
    raise PermissionError


ACTIONS: dict[str, Callable[[], object]] = {
    "CAN socket": open_socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW),
    "UNIX socket": open_socket(socket.AF_UNIX),
    "write to state folder": write_to(os.environ.get("STATE_DIRECTORY", "/")),
    "write to runtime folder": write_to(os.environ.get("RUNTIME_DIRECTORY", "/")),
    "internet socket": open_socket(socket.AF_INET),
    "netlink socket": open_socket(socket.AF_NETLINK, socket.SOCK_RAW),
    "packet socket": open_socket(socket.AF_PACKET, socket.SOCK_RAW),
    "write to /etc": write_to("/etc"),
    "write to its own code": write_to(str(Path(__file__).parent)),
    "list /root": lambda: os.listdir("/root"),
    "list /home": lambda: os.listdir("/home"),
    "memory that is written and executed": lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_WRITE | mmap.PROT_EXEC).close(),
    "be another user": lambda: os.setuid(0),
    "hold a capability": capabilities,
    "see process 1": lambda: os.stat("/proc/1"),
    "open a disk or console": lambda: os.open("/dev/ttyS0", os.O_RDWR),
    "mount": system_call(165, 0, 0, 0, 0, 0),
    "new user namespace": system_call(272, 0x10000000),
    "load a kernel module": system_call(313, 0, 0, 0),
    "realtime scheduling": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1)),
    "set the clock": lambda: __import__("time").clock_settime(0, 0.0),
}

if __name__ == "__main__":
    sys.exit(main())
