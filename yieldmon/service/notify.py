"""Talking to the service manager: the sd_notify protocol (systemd, sd_notify(3)) over its UNIX datagram socket."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections import deque
from collections.abc import Mapping

_log = logging.getLogger(__name__)

_MOST_UNSENT = 4


class ServiceManager:
    """Sends what happens to the service manager; does nothing when there is none."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """`environment` holds NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID where a service manager set them."""
        address = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the abstract name space.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        interval = environment.get("WATCHDOG_USEC", "")
        self._unsent: deque[str] = deque(maxlen=_MOST_UNSENT)
        """States that it took no notice of yet, in order."""
        self.watchdog_s: float | None = int(interval) / 1e6 if ours and interval.isdigit() else None

    def ready(self) -> None:
        """Started, or done with reloading."""
        self._announce("READY=1")

    def reloading(self) -> None:
        """Reading the configuration anew; ready() follows."""
        self._announce(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """On the way out."""
        self._announce("STOPPING=1")

    def alive(self) -> None:
        """Feeds the watchdog."""
        if self.watchdog_s is not None:
            self._send("WATCHDOG=1")

    def status(self, line: str) -> None:
        """One line for `systemctl status`."""
        self._send(f"STATUS={line}")

    def _announce(self, state: str) -> None:
        self._unsent.append(state)
        self._send()

    def _send(self, text: str = "") -> None:
        """What it took no notice of yet, and then the text, which is of no use later. A manager that reads nothing is not waited
        for."""
        if not self._address:
            self._unsent.clear()
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as sender:
                while self._unsent:
                    sender.sendto(self._unsent[0].encode(), self._address)
                    self._unsent.popleft()
                if text:
                    sender.sendto(text.encode(), self._address)
        except OSError as error:
            _log.warning("service manager: %s", error)
