"""The cab's view with its keys: the daemon's status, or what the frames report."""

from __future__ import annotations

import argparse
import time

from rich.console import RenderableType

from yieldmon.cli._monitor.daemon_link import PATIENCE_S, DaemonLink, Status, aged
from yieldmon.cli._typed_mass import mass
from yieldmon.files.units import units_of
from yieldmon.screen import keys
from yieldmon.screen.cab import NO_MONITOR, WAITS, Cab, from_frames
from yieldmon.screen.dialog import KEYS, Dialog
from yieldmon.screen.panels import Screen, View
from yieldmon.screen.traffic import Traffic
from yieldmon.service.operator.control_client import NoDaemonError, SilentDaemonError
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.units import UnitSystem


def _shipped_crop(name: str) -> str | None:
    # The crops' file needs numpy and yaml, the screen neither until a crop is asked for.
    from yieldmon.files.crops import shipped_name

    return shipped_name(name)


def _shipped_crops() -> tuple[str, ...]:
    from yieldmon.files.crops import crops

    return tuple(crops())


class CabView:
    """What is drawn, and what its keys ask of a daemon. daemon: None where none may be asked."""

    def __init__(self, args: argparse.Namespace, view: View, daemon: DaemonLink | None) -> None:
        self.view = view
        self.daemon = daemon
        self.dialog = Dialog(mass, _shipped_crop, _shipped_crops)
        self._system: str | None = args.units
        self._status: Status | None = None
        self._missed: ControlError | None = None
        self._absent = NO_MONITOR if "interface" in args or args.log else WAITS
        self._said = "metric", ""
        self._heard_s = time.monotonic()

    def look(self) -> None:
        """Take what the daemon has said since."""
        for news in self.daemon.news() if self.daemon is not None else ():
            if isinstance(news, str):
                self.dialog.report(self.view.units.in_text(news))
            else:
                self.know(news)

    def know(self, answer: Status | ControlError) -> None:
        """A status that was asked for, or the error in place of one."""
        if isinstance(answer, ControlError):
            self._missed = answer
        else:
            self._status, self._missed, self._heard_s = answer, None, time.monotonic()

    def screen(self, traffic: Traffic) -> RenderableType:
        """What to draw now."""
        status = self._status
        if status is not None:
            # Those of a daemon that answers no more stay.
            self._said = status["units"], status["crop"]["name"]
        self.view.units = units_of(self._system, *self._said)
        self.view.silence = self._silence()
        if not self.view.cab:
            return Screen(traffic, self.view)
        shown = from_frames(traffic, self._absent) if status is None else aged(status, time.monotonic() - self._heard_s)
        return Cab(shown, self.view.units, self.dialog.prompt, self.view)

    def _silence(self) -> str:
        """Why the daemon's own words are missing; "" where they are not, or the bus is watched without a daemon behind it."""
        silent_s = time.monotonic() - self._heard_s
        missed = self._missed
        if self.daemon is None or (isinstance(missed, NoDaemonError) and self._status is None):
            return ""
        if missed is not None and not isinstance(missed, SilentDaemonError):
            return str(missed)
        if missed is None and silent_s < PATIENCE_S:
            return ""
        return f"the daemon has not answered for {silent_s:.0f} s; if it lasts, `systemctl restart yieldmon`"

    def press(self, key: str) -> str | None:
        """Apply a key; what the caller has to do."""
        if self.view.cab:
            if key in ("q", "\x03") and not self.dialog.open:
                return "quit"
            asked = key in KEYS or self.dialog.open
            requests = self.dialog.press(key, self._status, self.view.units) if asked else ()
            if self.daemon is not None:
                self.daemon.request(*requests)
            if asked or key not in "cu ":
                return None
        what = keys.press(self.view, key)
        if what == "units":
            self._system = str(UnitSystem.METRIC if self.view.units.system is UnitSystem.US else UnitSystem.US)
            return None
        return what
