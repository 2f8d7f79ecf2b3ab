"""A text file for Prometheus' node exporter (textfile collector), replaced whole at each interval on a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from yieldmon.engine.faults import FaultCode
from yieldmon.files import whole_file

_log = logging.getLogger(__name__)

_STOP_S = 0.5


class MetricsFile:
    """Writes the status as metrics for as long as it runs; does nothing without a path."""

    def __init__(self, path: Path | None, interval_s: float, status: Callable[[], Mapping[str, Any]]) -> None:
        self._path = path
        self._interval_s = interval_s
        self._status = status
        self._stop = threading.Event()
        self._over = False
        self._busy_since_s: float | None = None
        self._thread = self._new_thread()

    def start(self) -> None:
        """Start writing."""
        if self._path is not None:
            self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs; without a path there is none."""
        return self._path is None or self._thread.is_alive()

    @property
    def busy_since_s(self) -> float | None:
        """Since when the thread has been writing one file, monotonic seconds; None while it waits for the next."""
        return self._busy_since_s

    def restart(self) -> None:
        """Leave the thread to itself and write on another one. Raises RuntimeError."""
        self._stop.set()
        self._stop = threading.Event()
        self._thread = self._new_thread()
        self._thread.start()

    def _new_thread(self) -> threading.Thread:
        return threading.Thread(target=self._run, args=(self._stop,), name="metrics", daemon=True)

    def stop(self) -> None:
        """Stop writing and take the file away, so that nothing stale is collected; a disk that hangs is not waited for."""
        if self._path is not None and not self.alive:
            self._take_away(self._path)
        self._over = True
        self._stop.set()
        if self._path is not None and self.alive:
            self._thread.join(_STOP_S)
            if self.alive:
                _log.warning("metrics: %s: the disk hangs; the file is left in place", self._path)

    @staticmethod
    def _take_away(path: Path) -> None:
        try:
            # A link is followed, as in writing; a pipe or a device is not ours to take away.
            target = whole_file.real_path(path)
            if target.is_file():
                target.unlink()
        except OSError as error:
            _log.warning("metrics: %s", error)

    def _run(self, stop: threading.Event) -> None:
        assert self._path is not None
        failed = contested = False
        written: tuple[int, int] | None = None
        while True:
            self._busy_since_s = time.monotonic()
            try:
                found = _version(self._path)
                if not contested and written is not None and found is not None and found != written:
                    contested = True
                    _log.warning(
                        "metrics: %s: another process writes it too; expected a file of its own for each daemon, "
                        "status.prometheus_file", self._path,
                    )  # fmt: skip
                write(self._path, self._status())
                written = _version(self._path)
                failed = False
            except Exception as error:  # noqa: BLE001 - a thread that dies in silence would leave what is stale for fresh
                if not failed:
                    _log.warning("metrics: %s", error)
                failed = True
            if not stop.is_set():
                self._busy_since_s = None
            if stop.wait(self._interval_s):
                if self._over:
                    # Else another thread writes it now.
                    self._take_away(self._path)
                return


def _version(path: Path) -> tuple[int, int] | None:
    """Identifies one writing of the file; None where there is no file."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns


def write(path: Path, status: Mapping[str, Any]) -> None:
    """Put a new file in the place of the old one, readable by all: the collector is another user.

    Raises InputError or OSError as `whole_file.scratch_for`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    whole_file.write(path, "".join(f"{line}\n" for line in lines(status)), mode=whole_file.READABLE)


def lines(status: Mapping[str, Any]) -> Iterator[str]:
    """The metrics in Prometheus' text format; a value that is not known is left out."""
    last = status["windows"][-1] if status["windows"] else {}
    bus, store = status["bus"], status["store"]
    active = {fault["code"] for fault in status["faults"]}
    yield from _metric("mass_flow_kg_per_second", "gauge", "Mass flow of the last window", last.get("mass_flow_kg_s"))
    yield from _metric("load_mass_kg", "gauge", "Mass of the load", status["load"]["mass_kg"])
    yield from _metric("mass_kg_total", "counter", "Mass measured so far", status["total"]["mass_kg"])
    contested_kg = status["total"]["contested_mass_kg"]
    yield from _metric("contested_mass_kg_total", "counter", "Mass of seconds that two nodes sent samples for", contested_kg)
    yield from _metric("frames_received_total", "counter", "Frames received since the start", bus["received"])
    dropped = bus["dropped"] + bus["kernel_drops"]
    yield from _metric("frames_dropped_total", "counter", "Frames dropped since the start", dropped)
    yield from _metric("frames_sent_total", "counter", "Frames sent since the start", bus["sent"])
    yield from _metric("store_pending", "gauge", "Seconds that wait for the store", store["pending"])
    yield from _metric("calibration_age_seconds", "gauge", "Age of the parameters", status["parameters"]["age_s"])
    yield from _metric("uptime_seconds", "gauge", "Time since the start", status["uptime_s"])
    yield from _metric("status_age_seconds", "gauge", "Age of these figures when they were written", status["age_s"])
    yield from _metric("status_stale", "gauge", "1 when the figures are no longer fresh", float(status["stale"]))
    yield from _metric("written_timestamp_seconds", "gauge", "When this file was written, Unix time", time.time())
    yield "# HELP yieldmon_fault 1 while the fault is shown"
    yield "# TYPE yieldmon_fault gauge"
    for code in FaultCode:
        yield f'yieldmon_fault{{code="{code.value}"}} {int(code.value in active)}'


def _metric(name: str, kind: str, meaning: str, value: float | None) -> Iterator[str]:
    if value is not None:
        yield f"# HELP yieldmon_{name} {meaning}"
        yield f"# TYPE yieldmon_{name} {kind}"
        yield f"yieldmon_{name} {value:.12g}"
