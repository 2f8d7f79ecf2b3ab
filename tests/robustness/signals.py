"""Signals in bursts at a running daemon: it lives, says so with a fresh status, reloads, and SIGTERM ends it within 5 s.

python -m tests.robustness signals --count 100000 --minutes 10

Signals that come while a reload is due are one reload, so a right count is no one number. Right is: the configuration is written
anew in the middle of each burst, and what a burst's last signal finds in it is in use thereafter (no signal is lost: a reload
began after it); so there are at least as many reloads as bursts; at most as many as signals; and none without a signal, once all
are answered. Ends with 1 when one of this does not hold.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

_START_S, _STOP_S = 60.0, 5.0
_BURST = 500
_UNITS = ("metric", "us")
_ANSWER_S, _QUIET_S = 60.0, 3.0
"""How long a reload may take to be seen, and how long afterwards none more may come."""


def bombard(folder: Path, count: int, minutes: float, seed: int) -> dict[str, Any]:
    """What became of a daemon on a silent virtual bus under so many SIGHUPs."""
    _configure(folder, 0)
    environment = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    command = [sys.executable, "-m", "yieldmon.cli.main", "run", "--config", str(folder / "c.yaml")]
    rng = random.Random(seed)
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen(command, env=environment, stderr=log)
        _status(folder, _START_S)
        sent, bursts, lost, began_s = 0, 0, 0, time.monotonic()
        while sent < count and daemon.poll() is None:
            size = min(_BURST, count - sent)
            bursts += 1
            # At least the last one comes after what it is to find; often it alone, with a reload under way.
            changes_at = rng.choice((size - 1, rng.randrange(size)))
            pause_s = rng.choice((0.0, 0.001, 0.002))
            for number in range(size):
                if number == changes_at:
                    _configure(folder, bursts)
                daemon.send_signal(signal.SIGHUP)
                time.sleep(pause_s)
            sent += size
            lost += not _in_use(folder, bursts)
            left_s = 60.0 * minutes * sent / count - (time.monotonic() - began_s)
            time.sleep(max(0.0, rng.uniform(0.5, 1.5) * left_s))
        alive = daemon.poll() is None
        time.sleep(_QUIET_S)
        quiet = _status(folder, 30.0) if alive else {}
        time.sleep(_QUIET_S)
        status = _status(folder, 30.0) if alive else {}
        asked_s = time.monotonic()
        daemon.send_signal(signal.SIGTERM)
        try:
            code: int | None = daemon.wait(30.0)
        except subprocess.TimeoutExpired:
            daemon.kill()
            code = None
    reported, before = (found.get("configuration", {}) for found in (status, quiet))
    return {
        "signals": sent, "bursts": bursts, "alive": alive, "stale": status.get("stale"), "reloads": reported.get("reloads"),
        "bursts_lost": lost, "reloads_without_signal": reported.get("reloads", 0) - before.get("reloads", 0),
        "reload": reported.get("reload"), "exit": code, "stop_s": round(time.monotonic() - asked_s, 2),
    }  # fmt: skip


def count_is_right(report: dict[str, Any]) -> bool:
    """Whether as many reloads came as the signals ask for."""
    enough = bool(report["bursts"] <= (report["reloads"] or 0) <= report["signals"])
    return enough and report["bursts_lost"] == 0 and report["reloads_without_signal"] == 0 and report["reload"] == "taken"


def _configure(folder: Path, number: int) -> None:
    """The configuration with a value that the one before has not, all at once."""
    fresh = folder / "c.yaml.new"
    fresh.write_text(f"bus: {{interface: virtual, channel: signals}}\nunits: {_UNITS[number % 2]}\n", encoding="utf-8")
    fresh.replace(folder / "c.yaml")


def _in_use(folder: Path, number: int) -> bool:
    """Whether the daemon comes to use that configuration, and not the one before, in _ANSWER_S."""
    end_s = time.monotonic() + _ANSWER_S
    while time.monotonic() < end_s:
        if _status(folder, _ANSWER_S)["units"] == _UNITS[number % 2]:
            return True
        time.sleep(0.05)
    return False


def _status(folder: Path, timeout_s: float) -> dict[str, Any]:
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            return ask(folder / "yieldmon.sock", {"command": "status"})
        except ControlError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


def main(arguments: list[str]) -> int:
    """Prints what became of the daemon as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        report = bombard(Path(folder), args.count, args.minutes, args.seed)
    json.dump(report, sys.stdout, indent=2)
    print()
    fine = report["alive"] and report["stale"] is False and report["exit"] == 0 and report["stop_s"] <= _STOP_S
    return 0 if fine and count_is_right(report) else 1
