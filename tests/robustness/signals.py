"""Signals in bursts at a running daemon: it lives, says so with a fresh status, reloads, and SIGTERM ends it within 5 s.

python -m tests.robustness signals --count 100000 --minutes 10
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

from yieldmon.service.control import ControlError, ask

_START_S, _STOP_S = 60.0, 5.0
_BURST = 500


def bombard(folder: Path, count: int, minutes: float, seed: int) -> dict[str, Any]:
    """What became of a daemon on a silent virtual bus under so many SIGHUPs."""
    (folder / "c.yaml").write_text("bus: {interface: virtual, channel: signals}\n", encoding="utf-8")
    environment = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    command = [sys.executable, "-m", "yieldmon.cli.main", "run", "--config", str(folder / "c.yaml")]
    rng = random.Random(seed)
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen(command, env=environment, stderr=log)
        _status(folder, _START_S)
        sent, began_s = 0, time.monotonic()
        while sent < count and daemon.poll() is None:
            for _ in range(min(_BURST, count - sent)):
                daemon.send_signal(signal.SIGHUP)
                sent += 1
            left_s = 60.0 * minutes * sent / count - (time.monotonic() - began_s)
            time.sleep(max(0.0, rng.uniform(0.5, 1.5) * left_s))
        alive = daemon.poll() is None
        time.sleep(1.0)
        status = _status(folder, 30.0) if alive else {}
        asked_s = time.monotonic()
        daemon.send_signal(signal.SIGTERM)
        try:
            code: int | None = daemon.wait(30.0)
        except subprocess.TimeoutExpired:
            daemon.kill()
            code = None
    return {
        "signals": sent, "alive": alive, "stale": status.get("stale"),
        "reloads": status.get("configuration", {}).get("reloads"), "reload": status.get("configuration", {}).get("reload"),
        "exit": code, "stop_s": round(time.monotonic() - asked_s, 2),
    }  # fmt: skip


def _status(folder: Path, patience_s: float) -> dict[str, Any]:
    end_s = time.monotonic() + patience_s
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
    return 0 if fine and 1 <= (report["reloads"] or 0) <= report["signals"] else 1
