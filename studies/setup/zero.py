"""Zero pressed at 14 kg/s on a running daemon and the virtual combine over udp_multicast: python -m studies.setup.zero [--tank]

Real time, 4 min: 20 s empty, 170 s at 14 kg/s, 55 s empty. `yieldmon zero` and `yieldmon zero --force` are pressed after 60 s,
`yieldmon zero --undo` after 228 s; what `status` says is printed. --tank: with a scale, which stands still after the field.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

GROUP, PORT = "239.74.163.21", 43221
PRESSED_S, LOOKED_AT_S, UNDONE_S = 60.0, (130.0, 185.0, 215.0), 228.0
PIECES = [{"kind": "steady", "duration_s": s, "flow_kg_s": flow} for s, flow in ((20, 0), (170, 14), (55, 0))]
_YIELDMON = (sys.executable, "-m", "yieldmon")


class Daemon:
    """A running daemon, asked by its own commands."""

    def __init__(self, folder: Path) -> None:
        self._config = str(folder / "yieldmon.yaml")
        bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
        Path(self._config).write_text(json.dumps({"bus": bus, "reference_masses": {"min_increment_kg": 500}}), encoding="utf-8")
        folders = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
        self.process = subprocess.Popen([*_YIELDMON, "run", "--config", self._config], env=os.environ | folders)
        self._environment = os.environ | folders
        while self.ask("status", "--json").returncode:
            if self.process.poll() is not None:
                raise SystemExit("the daemon did not start")
            time.sleep(0.5)

    def ask(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A command with this daemon's configuration."""
        command = [*_YIELDMON, *words, "--config", self._config]
        return subprocess.run(command, capture_output=True, text=True, check=False, env=self._environment)

    def told(self, *words: str) -> None:
        """Prints a command, its exit status and its answer."""
        done = self.ask(*words)
        print(f"yieldmon {' '.join(words)}: {done.returncode}; {(done.stdout + done.stderr).strip()}", flush=True)

    def status(self, at_s: float, what: str) -> dict[str, Any]:
        """`status`, printed in a line."""
        found: dict[str, Any] = json.loads(self.ask("status", "--json").stdout)
        faults = ", ".join(fault["code"] for fault in found["faults"]) or "no faults"
        print(f"{at_s:6.1f} s  {what}: load {found['load']['mass_kg']:.1f} kg, {faults}", flush=True)
        return found


def run(folder: Path, *, tank: bool) -> None:
    """The field, the wrong zero and its undo."""
    scenario, truth = folder / "scenario.yaml", folder / "truth.csv"
    field = {"duration_s": 245, "flow": {"variation_pct": 3, "pieces": PIECES}, "tank": {"scale": tank, "unload_from_kg": 8000}}
    scenario.write_text(json.dumps(field), encoding="utf-8")
    daemon = Daemon(folder)
    try:
        bus = ("-i", "udp_multicast", "-c", GROUP, "--bus-kwargs", f"port={PORT}")
        words = ("simulate", "--scenario", str(scenario), "--seed", "7", "--truth", str(truth), *bus)
        combine = subprocess.Popen([*_YIELDMON, *words], stdout=subprocess.DEVNULL)
        began_s = time.monotonic()

        def at(seconds: float) -> float:
            time.sleep(max(0.0, began_s + seconds - time.monotonic()))
            return time.monotonic() - began_s

        daemon.status(at(PRESSED_S), "before")
        daemon.told("zero")
        daemon.told("zero", "--force")
        forced_s = at(0.0)
        while not any(fault["code"] == "ZeroDrifted" for fault in daemon.status(at(0.0), "under the wrong zero")["faults"]):
            if at(0.0) > LOOKED_AT_S[0]:
                raise SystemExit("no fault says that the zero is wrong")
            time.sleep(1.0)
        print(f"ZeroDrifted seen {at(0.0) - forced_s:.1f} s after --force", flush=True)
        for seconds in LOOKED_AT_S:
            daemon.status(at(seconds), "under the wrong zero")
        at(UNDONE_S)
        daemon.told("zero", "--undo")
        daemon.status(at(UNDONE_S + 4.0), "after the undo")
        combine.wait()
        names, *rows = (line.split(",") for line in truth.read_text(encoding="utf-8").splitlines())
        print(f"true: {float(rows[-1][names.index('total_mass_kg')]):.1f} kg")
    finally:
        daemon.process.send_signal(signal.SIGTERM)
        daemon.process.wait()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tank", action="store_true", help="with a tank scale")
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder), tank=parser.parse_args().tank)


if __name__ == "__main__":
    main()
