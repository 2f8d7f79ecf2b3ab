"""The page under attack beside a daemon that measures: nothing measured suffers, nothing is let in, memory stays bounded.

    python -m tests.robustness web-attack [--seconds S] [--turns N] [--connections C]

The daemon and the page are processes of their own, the bus is python-can's udp_multicast, the traffic nominal and in real time.
Turn about quiet and under attack for S seconds: C connections that send a byte now and then, bodies that never end, answers that
nobody takes, connections that come and go, requests of other sites and other hosts, guessed tokens and cookies, commands without
end; and at the daemon's own socket as many half-open peers, peers that ask without end and take no answer, and requests byte by
byte (--control-only: these alone). Attackers are a process of their own and come from 127.0.0.66, a driver with the token from
127.0.0.1. Prints one JSON document, with the time from each window's end until its MassFlow frame is in a socket of this process.
Exit code 1 where a window is missing, more windows come over --late-ms after their end under attack than without, something is
let in, the daemon's processor time for a second of traffic rises by more than --rise-pct of a core, page or daemon grows by more
than --growth-mb from the first attack to the last, or the driver is not answered within --answer-s afterwards.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any

from tests.robustness.daemon_cost import GROUP, PORT, ROOT, WARM_UP_S, Listener, Player, cpu_time_s, nearest_rank, traffic
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

ATTACKER = "127.0.0.66"
TOKEN = "correct-horse-battery-staple"
_PAUSE_S = 0.05


def connected(port: int, seconds: float = 5.0) -> socket.socket:
    """A connection of an attacker."""
    return socket.create_connection(("127.0.0.1", port), seconds, (ATTACKER, 0))


class Attack:
    """Threads of attackers until `stop`; `answers` counts their answers, by kind and status."""

    def __init__(self, port: int, control: Path, connections: int, seed: int, *, control_only: bool = False) -> None:
        self.answers: Counter[str] = Counter()
        self._port, self._control, self._connections = port, control, connections
        self._over = threading.Event()
        self._held: list[socket.socket] = []
        kinds: list[Callable[[random.Random], None]] = [
            self._half_open_control, self._takes_no_answer, self._byte_by_byte, self._byte_by_byte,
        ]  # fmt: skip
        if not control_only:
            kinds += [
                self._slow_bytes, self._come_and_go, self._other_site, self._other_host, self._guess, self._endless_body,
                self._takes_nothing, self._long_headers,
            ]  # fmt: skip
        self._threads = [
            threading.Thread(target=self._on, args=(kind, random.Random(f"{seed}/{number}")), daemon=True)
            for number, kind in enumerate(kinds)
        ]

    def __enter__(self) -> Attack:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        for one in self._held:
            one.close()

    def _on(self, kind: Callable[[random.Random], None], rng: random.Random) -> None:
        while not self._over.wait(_PAUSE_S * rng.random()):
            with suppress(OSError, HTTPException):
                kind(rng)

    def _keep(self, make: Callable[[], socket.socket], most: int, rng: random.Random, byte: bytes, pause_s: float = 0.01) -> None:
        """Holds so many connections, each with another byte now and then; those that were cut off are opened again."""
        held: list[socket.socket] = []
        while not self._over.wait(pause_s):
            if len(held) < most:
                with suppress(OSError):
                    held.append(make())
                    continue
            one = rng.choice(held) if held else None
            try:
                if one is not None:
                    one.send(byte)
            except OSError:
                assert one is not None
                held.remove(one)
                one.close()
        self._held += held

    def _slow_bytes(self, rng: random.Random) -> None:
        self._keep(lambda: connected(self._port), self._connections, rng, b"G")

    def _half_open_control(self, rng: random.Random) -> None:
        # Faster than those at the page, so that some speak while they are cut off.
        self._keep(self._peer, self._connections, rng, b"{", 0.0005)

    def _peer(self) -> socket.socket:
        peer = socket.socket(socket.AF_UNIX)
        peer.settimeout(0.5)
        peer.connect(str(self._control))
        return peer

    def _takes_no_answer(self, rng: random.Random) -> None:
        """Asks, and leaves the answer where it is."""

        def make() -> socket.socket:
            peer = self._peer()
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            peer.sendall(b'{"command": "status"}\n')
            return peer

        self._keep(make, self._connections, rng, b'{"command": "status"}\n', 0.005)

    def _byte_by_byte(self, rng: random.Random) -> None:
        """A request that takes up to 2 s to come, and is answered."""
        with self._peer() as peer:
            for byte in b'{"command": "status"}\n':
                peer.sendall(bytes((byte,)))
                self._over.wait(0.1 * rng.random())
            peer.settimeout(5.0)
            received = b""
            while not received.endswith(b"\n") and (piece := peer.recv(65536)):
                received += piece
            with suppress(ValueError):
                self.answers["byte by byte " + ("200" if json.loads(received)["ok"] else "503")] += 1

    def _come_and_go(self, rng: random.Random) -> None:
        for _ in range(20):
            connected(self._port).close()

    def _ask(self, kind: str, method: str, path: str, headers: dict[str, str], body: str | None = None) -> None:
        connection = HTTPConnection("127.0.0.1", self._port, timeout=5.0, source_address=(ATTACKER, 0))
        try:
            connection.request(method, path, body, headers)
            self.answers[f"{kind} {connection.getresponse().status}"] += 1
        finally:
            connection.close()

    def _other_site(self, rng: random.Random) -> None:
        command = json.dumps({"command": rng.choice(("load-start", "zero", "sweep-start"))})
        origin = rng.choice(
            ("https://evil.example", "null", f"http://127.0.0.1:{self._port + 1}", f"http://localhost.evil:{self._port}")
        )
        kind = rng.choice(("application/json", "text/plain", "application/x-www-form-urlencoded"))
        authorised = {"authorization": f"Bearer {TOKEN}"} if rng.random() < 0.5 else {}
        headers = {"origin": origin, "content-type": kind, "sec-fetch-site": "cross-site", **authorised}
        self._ask("other site", "POST", "/api/command", headers, command)

    def _other_host(self, rng: random.Random) -> None:
        # Another port of this machine is not among them: a tunnel's user asks by it, and no name of somebody else's leads there.
        host = rng.choice(("evil.example", f"evil.example:{self._port}", "127.0.0.1.nip.io", "", "[::1"))
        self._ask("other host", "GET", "/api/page", {"host": host, "authorization": f"Bearer {TOKEN}"})

    def _guess(self, rng: random.Random) -> None:
        guess = rng.choice((TOKEN[:-1], TOKEN + "x", "", rng.randbytes(12).hex(), TOKEN.upper()))
        if rng.random() < 0.5:
            origin = f"http://127.0.0.1:{self._port}"
            headers = {"origin": origin, "content-type": "application/json"}
            self._ask("sign in", "POST", "/sign-in", headers, json.dumps({"token": guess}))
        else:
            until = str(int(time.time()) + rng.randrange(10**7))
            given = {"cookie": f"yieldmon={until}.{rng.randbytes(32).hex()}"} if rng.random() < 0.5 else {}
            self._ask("guess", "GET", "/api/history", given or {"authorization": f"Bearer {guess}"})

    def _endless_body(self, rng: random.Random) -> None:
        with connected(self._port) as one:
            head = (
                f"POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\nOrigin: http://127.0.0.1:{self._port}\r\n"
                "Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
            )
            one.sendall(head.encode())
            for _ in range(10_000):
                if self._over.is_set():
                    return
                one.sendall(b"1000\r\n" + b"[" * 4096 + b"\r\n")

    def _takes_nothing(self, rng: random.Random) -> None:
        with connected(self._port) as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            for _ in range(300):
                one.sendall(f"GET /static/live.js HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\n\r\n".encode())
            self._over.wait(6.0)

    def _long_headers(self, rng: random.Random) -> None:
        with connected(self._port) as one:
            one.sendall(b"GET / HTTP/1.1\r\nX: " + b"a" * 200_000)
            one.recv(100)


#: What an attacker may be answered; all else was let in.
REFUSED = {
    "byte by byte": {200, 503},
    "other site": {403, 429},
    "other host": {400, 421, 429},
    "sign in": {400, 401, 429},
    "guess": {401, 429},
}


def let_in(answers: Counter[str]) -> list[str]:
    """Answers that no attacker should have had."""
    found = []
    for key in answers:
        kind, _, status = key.rpartition(" ")
        if int(status) not in REFUSED[kind]:
            found.append(key)
    return found


@contextmanager
def attacked(port: int, control: Path, seed: int, options: argparse.Namespace) -> Iterator[Counter[str]]:
    """An attack from another process, so that it holds up no traffic that this one sends; its answers, once it is over."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()

    def run_attack() -> None:
        with Attack(port, control, options.connections, seed, control_only=options.control_only) as attack:
            there.recv()
        there.send(attack.answers)

    attacker = context.Process(target=run_attack)
    attacker.start()
    answers: Counter[str] = Counter()
    try:
        yield answers
    finally:
        here.send(None)
        answers += here.recv()
        attacker.join()


def _quantiles(found: list[float]) -> dict[str, float]:
    shares = {"p50": 0.5, "p99": 0.99, "most": 1.0}
    return {name: round(nearest_rank(sorted(found), share), 1) for name, share in shares.items()}


def memory_mb(pid: int) -> float:
    """Resident memory now."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024.0
    return 0.0


def threads(pid: int) -> int:
    """Threads now."""
    return len(list(Path(f"/proc/{pid}/task").iterdir()))


def answers_status(control: Path) -> bool:
    """Whether the daemon's socket answers the operator within five tries, in the middle of the attack."""
    for _ in range(5):
        with suppress(ControlError):
            ask(control, {"command": "status"}, 5.0)
            return True
    return False


def driver_s(port: int) -> float:
    """How long the page takes to answer somebody with the token, s; infinite where it does not."""
    began_s = time.monotonic()
    connection = HTTPConnection("127.0.0.1", port, timeout=20.0)
    try:
        connection.request("GET", "/api/history", headers={"authorization": f"Bearer {TOKEN}"})
        return time.monotonic() - began_s if connection.getresponse().status == 200 else float("inf")
    except (OSError, HTTPException):
        return float("inf")
    finally:
        connection.close()


@contextmanager
def processes(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], subprocess.Popen[bytes], int]]:
    """The daemon, the page and the page's port."""
    bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
    (folder / "c.yaml").write_text(json.dumps({"bus": bus}))
    (folder / "token").write_text(TOKEN + "\n")
    (folder / "token").chmod(0o600)
    environment = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    base = [sys.executable, "-m", "yieldmon"]
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen([*base, "run", "--config", str(folder / "c.yaml")], cwd=ROOT, env=environment, stderr=log)
        page = None
        try:
            for _ in range(1200):
                with suppress(ControlError):
                    ask(folder / "yieldmon.sock", {"command": "status"})
                    break
                time.sleep(0.1)
            options = ["--config", str(folder / "c.yaml"), "--listen", "127.0.0.1:0", "--token-file", str(folder / "token")]
            page = subprocess.Popen([*base, "web", *options], cwd=ROOT, env=environment, stderr=subprocess.PIPE)
            assert page.stderr is not None
            line = page.stderr.readline().decode()
            yield daemon, page, int(line.strip().rstrip("/").rpartition(":")[2])
        finally:
            for process in (page, daemon):
                if process is not None:
                    process.terminate()
                    process.wait(60.0)


def run(folder: Path, options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Figures, and whether all held."""
    import can

    messages = traffic(WARM_UP_S + 2 * options.turns * options.seconds + 1.0)
    shares: dict[str, list[float]] = {"quiet": [], "attacked": []}
    latencies: dict[str, list[float]] = {"quiet": [], "attacked": []}
    delays: dict[str, list[float]] = {"quiet": [], "attacked": []}
    missed, answers, memory = 0, Counter[str](), []
    most_threads = unanswered = 0
    with (
        processes(folder) as (daemon, page, port),
        can.Bus(GROUP, interface="udp_multicast", port=PORT) as sender,
        Listener() as listener,
        ThreadPoolExecutor(1) as asker,
    ):
        player = Player(sender, messages)
        player.play(WARM_UP_S, filler=False)
        for turn in range(2 * options.turns):
            kind = ("quiet", "attacked")[turn % 2]
            before_s, cpu_s = time.monotonic(), cpu_time_s(daemon.pid)
            listener.begin()
            if kind == "attacked":
                with attacked(port, folder / "yieldmon.sock", turn, options) as attack:
                    # Beside the traffic: a bus that is silent meanwhile closes its windows by the clock.
                    asking = asker.submit(answers_status, folder / "yieldmon.sock")
                    player.play(options.seconds, filler=False)
                    delays[kind] += listener.delays_ms()
                    unanswered += not asking.result()
                    memory.append((memory_mb(daemon.pid), memory_mb(page.pid)))
                    most_threads = max(most_threads, threads(daemon.pid))
                answers += attack
            else:
                player.play(options.seconds, filler=False)
                delays[kind] += listener.delays_ms()
            shares[kind].append(100.0 * (cpu_time_s(daemon.pid) - cpu_s) / (time.monotonic() - before_s))
            phase = listener.phase(kind, 0.0, 0.0)
            latencies[kind].append(phase.latency_p50_ms)
            missed += phase.missed
        answer_s = driver_s(port)
        status = ask(folder / "yieldmon.sock", {"command": "status"})
        alive = daemon.poll() is None and page.poll() is None
    journal = (folder / "log").read_text().splitlines()
    rise_pct = statistics.median(shares["attacked"]) - statistics.median(shares["quiet"])
    growth_mb = [round(last - first, 1) for first, last in zip(memory[0], memory[-1], strict=True)]
    late = {kind: sum(delay > options.late_ms for delay in found) for kind, found in delays.items()}
    figures = {
        "seconds": options.seconds, "turns": options.turns, "connections": options.connections,
        "missed_windows": missed, "frames_dropped": status["bus"]["dropped"], "late": status["bus"]["late"],
        "core_share_pct": {name: [round(x, 2) for x in found] for name, found in shares.items()}, "rise_pct": round(rise_pct, 2),
        "windows": {kind: len(found) for kind, found in delays.items()},
        "windows_late": late,
        "window_delay_ms": {kind: _quantiles(found) for kind, found in delays.items()},
        "latency_p50_ms": {name: [round(x, 1) for x in found] for name, found in latencies.items()},
        "memory_mb": [[round(x, 1) for x in pair] for pair in memory], "growth_mb": growth_mb,
        "daemon_threads": most_threads, "status_unanswered": unanswered,
        "answers": dict(sorted(answers.items())), "let_in": let_in(answers), "driver_answered_s": round(answer_s, 2),
        "journal_lines": len(journal), "load_number": status["load"]["number"],
    }  # fmt: skip
    held = (
        alive and not missed and not unanswered and late["attacked"] <= late["quiet"]
        and not figures["let_in"] and not status["bus"]["dropped"] and rise_pct <= options.rise_pct
        and max(growth_mb) <= options.growth_mb and answer_s <= options.answer_s and status["load"]["number"] == 1
    )  # fmt: skip
    return figures, held


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when all held."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness web-attack", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=15.0, metavar="S", help="of each turn (default: 15)")
    parser.add_argument("--turns", type=int, default=3, metavar="N", help="of each kind (default: 3)")
    parser.add_argument("--connections", type=int, default=200, metavar="C", help="held open (default: 200)")
    parser.add_argument(
        "--late-ms", type=float, default=200.0, metavar="MS", help="a window that comes later is late (default: 200)"
    )
    parser.add_argument("--control-only", action="store_true", help="attack the daemon's socket alone")
    parser.add_argument("--rise-pct", type=float, default=5.0, metavar="P", help="of a core (default: 5)")
    parser.add_argument("--growth-mb", type=float, default=10.0, metavar="MB", help="(default: 10)")
    parser.add_argument("--answer-s", type=float, default=5.0, metavar="S", help="(default: 5)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        figures, held = run(Path(folder), options)
    print(json.dumps({"load_average": round(os.getloadavg()[0], 1), **figures, "held": held}, indent=2))
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
