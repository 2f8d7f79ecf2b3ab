"""Kill -9 of workers, client and scheduler of a fleet run at random; the dataset must be that of an undisturbed run, to the byte.

    python -m tests.robustness fleet-kill [--partitions N] [--workers-killed N] [--clients-killed N] [--schedulers-killed N]

Scheduler and workers are Dask's own commands, as on a cluster. Whoever was killed is started again, as a service manager does.
"""

from __future__ import annotations

import argparse
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fleet import logs
from tests.fleet.logs import dataset_files
from yieldmon.fleet.dataset_files import MARK

_WORKERS = 2
_QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


class Cluster:
    """A scheduler, workers and a client, each a process of its own, by name."""

    def __init__(self, source: Path, out: Path, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        address = f"tcp://127.0.0.1:{port}"
        dask, yieldmon = ([sys.executable, "-m", module] for module in ("dask", "yieldmon.cli.main"))
        self._commands = {
            "scheduler": [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"],
            "client": [*yieldmon, "fleet", "run", str(source), "--out", str(out), "--scheduler", address],
        }
        for number in range(_WORKERS):
            home = folder / f"worker-{number}"
            home.mkdir()
            self._commands[f"worker-{number}"] = [
                *dask, "worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(home),
                "--memory-limit", "0",
            ]  # fmt: skip
        self.said = folder / "client.txt"
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self.starts: Counter[str] = Counter()

    def keep_up(self) -> int | None:
        """Start whoever is not there; the client's exit code once it has come to its end by itself."""
        for name, command in self._commands.items():
            process = self._running.get(name)
            if process is not None and process.poll() is None:
                continue
            if name == "client" and process is not None and process.returncode >= 0:
                return process.returncode
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            with self.said.open("ab") as said:
                streams = {"stdout": subprocess.DEVNULL, "stderr": said if name == "client" else subprocess.DEVNULL}
                self._running[name] = subprocess.Popen(command, env=environment, **streams)  # type: ignore[call-overload]
            self.starts[name] += 1
        return None

    def kill(self, name: str) -> bool:
        """Kill -9, now; whether there was something to kill."""
        process = self._running.get(name)
        if process is None or process.poll() is not None:
            return False
        process.kill()
        process.wait()
        return True

    def stop(self) -> None:
        """End all."""
        for name in self._running:
            self.kill(name)


def main(arguments: list[str]) -> int:
    """Exit code 0 when the disturbed run made the same dataset."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness fleet-kill", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--partitions", type=int, default=1000)
    parser.add_argument("--workers-killed", type=int, default=100)
    parser.add_argument("--clients-killed", type=int, default=10)
    parser.add_argument("--schedulers-killed", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        return _run(args, Path(name))


def _run(args: argparse.Namespace, folder: Path) -> int:
    chance = random.Random(args.seed)
    source, undisturbed, out = folder / "tree", folder / "undisturbed", folder / "disturbed"
    kinds = [logs.write(folder / f"kind-{mv}.log", float(mv)) for mv in (40, 50, 60, 70)]
    for number in range(args.partitions):
        day = source / f"m{number % 10}" / f"d{number // 10:04d}"
        day.mkdir(parents=True)
        # A blank line more for each: the same log twice on one machine would be counted once.
        (day / "a.log").write_bytes(kinds[number % len(kinds)].read_bytes() + b"\n" * (number // 10))
    command = [sys.executable, "-m", "yieldmon.cli.main", "fleet", "run", str(source), "--out", str(undisturbed)]
    subprocess.run([*command, "--workers", "0"], check=True, **_QUIET)  # type: ignore[call-overload]
    kills = ["worker"] * args.workers_killed + ["client"] * args.clients_killed + ["scheduler"] * args.schedulers_killed
    chance.shuffle(kills)
    # Each when a certain share is done, so that all of them meet a run at work.
    at = sorted(chance.uniform(0.0, 0.95) * args.partitions for _ in kills)
    cluster, done, began_s = Cluster(source, out, folder), Counter[str](), time.monotonic()
    try:
        code = None
        while code is None:
            code = cluster.keep_up()
            time.sleep(chance.uniform(0.0, 0.3))
            if at and len(list(out.glob("machine=*/day=*/_COMMITTED"))) >= at[0]:
                kind = kills[-1]
                if cluster.kill(f"worker-{chance.randrange(_WORKERS)}" if kind == "worker" else kind):
                    at.pop(0)
                    kills.pop()
                    done[kind] += 1
            if cluster.starts["client"] > args.clients_killed + 20:
                break
    finally:
        cluster.stop()
    expected, found = dataset_files(undisturbed), dataset_files(out)
    differ = [path for path in expected if found.get(path) != expected[path]]
    orphans = [path for path in found if path not in expected]
    marks = sum(path.endswith(f"/{MARK}") for path in found)
    print(f"{args.partitions} partitions, seed {args.seed}; killed: {dict(done)}; client's exit code {code}")
    print(f"starts: {dict(cluster.starts)}; {marks} partitions committed; {time.monotonic() - began_s:.0f} s")
    print(f"{len(expected) - len(differ)} of {len(expected)} files equal to the undisturbed run, {len(orphans)} orphans")
    for path in (*differ[:5], *orphans[:5]):
        print(f"  {path}")
    if code != 0:
        print("\n".join(cluster.said.read_text().splitlines()[-10:]))
    return 0 if code == 0 and not differ and not orphans and not kills and marks == args.partitions else 1
