"""The page in a browser and beside a daemon, in figures.

    python -m tests.robustness web-page soak [--hours H] [--pace P]    # live page at P times its pace: heap, missed seconds
    python -m tests.robustness web-page map [--points N] [--real F...] # a store of N points: shown and moved after how long
    python -m tests.robustness web-page faults [--count N]             # from the daemon's answer to the page
    python -m tests.robustness web-page cost [--seconds S]             # daemon's processor time with three pages and with none

All but `cost` need chromium and use a stand-in for the daemon; `cost` runs the daemon on python-can's udp_multicast, as
daemon-cost does, turn about with no page and with three. Exit code 1 where a figure is beyond what is promised: heap growth 5 MB,
no second missed; 1 s until a map is drawn, and for a move of it; 1 s for a fault; 1 % of a core.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.web.browser import Watched, opened
from tests.web.standin import HOME, StandIn, fault, page, row, standing_in
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import DEFAULT_FLOW_S
from yieldmon.service.storage.rows import SecondRow

Points = NDArray[np.float64]
FLOW_DELAY_S = int(DEFAULT_FLOW_S)
HEAP_GROWTH_MB, MAP_S, FAULT_S, COST_PCT = 5.0, 1.0, 1.0, 1.0
PAGES = 3
#: Until heap and map have the size at which they stay or grow with points alone.
_WARM_UP_S = 7200
_HEAP = "(gc(), performance.memory.usedJSHeapSize)"
_DRAWN = "Number(document.querySelector('#map canvas').dataset.drawn)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when each figure is within what is promised."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness web-page", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("soak", "map", "faults", "cost"))
    parser.add_argument("--hours", type=float, default=12.0, metavar="H", help="soak: simulated (default: 12)")
    parser.add_argument("--pace", type=int, default=60, metavar="P", help="soak: simulated over real time (default: 60)")
    parser.add_argument("--points", type=int, default=110_000, metavar="N", help="map: (default: 110000)")
    parser.add_argument(
        "--real", type=Path, nargs="+", metavar="F", help="map: harvests whose places and flows to take, put side by side"
    )
    parser.add_argument("--count", type=int, default=20, metavar="N", help="faults: (default: 20)")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S", help="cost: of each turn (default: 30)")
    options = parser.parse_args(arguments)
    run = {"soak": soak, "map": large_map, "faults": faults, "cost": cost}[options.part]
    with tempfile.TemporaryDirectory() as folder:
        figures, within = run(Path(folder), options)
    print(json.dumps({"part": options.part, "load_average": round(os.getloadavg()[0], 1), **figures, "within": within}))
    return 0 if within else 1


@contextmanager
def live_page(daemon: StandIn) -> Iterator[Watched]:
    """The live page in a browser, showing what the stand-in says."""
    with page(daemon.socket) as site, opened() as browser, Watched(browser) as watched:
        watched.page.goto(site)
        watched.wait(f"Number(document.body.dataset.last) >= {daemon.number}")
        yield watched


def soak(folder: Path, options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Simulated time runs faster; the heap is looked at after collection."""
    until = round(3600 * options.hours)
    with standing_in(folder) as daemon:
        daemon.seconds(1)
        with live_page(daemon) as watched:
            stop = threading.Event()

            def play() -> None:
                began_s = time.monotonic()
                while daemon.number < until and not stop.wait(0.2):
                    due = min(until, round((time.monotonic() - began_s) * options.pace)) - daemon.number
                    if due > 0:
                        daemon.seconds(due)

            playing = threading.Thread(target=play)
            playing.start()
            heaps: list[tuple[int, float]] = []
            try:
                while not heaps or heaps[-1][0] < until:
                    watched.page.wait_for_timeout(2000)
                    heaps.append((int(watched.evaluate("document.body.dataset.last")), watched.evaluate(_HEAP) / 1e6))
                    assert playing.is_alive() or daemon.number == until
            finally:
                stop.set()
                playing.join()
            missed = int(watched.evaluate("document.body.dataset.missed"))
            complaints = watched.complaints
    begin = next(heap for number, heap in heaps if number >= min(_WARM_UP_S, until // 4))
    growth_mb = heaps[-1][1] - begin
    figures = {
        "seconds": until, "missed": missed, "heap_first_mb": round(heaps[0][1], 2), "heap_begin_mb": round(begin, 2),
        "heap_end_mb": round(heaps[-1][1], 2), "growth_mb": round(growth_mb, 2),
        "growth_from_first_mb": round(heaps[-1][1] - heaps[0][1], 2), "complaints": complaints,
    }  # fmt: skip
    return figures, missed == 0 and heaps[-1][1] - heaps[0][1] < HEAP_GROWTH_MB and not complaints


def large_map(folder: Path, options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """The history page with all points of a large store: shown, and moved, so long after its load event. By the browser's clock.

    The first turn meets a server and a browser that have just started.
    """
    points = real_points(options.real, options.points) if options.real else None
    count = options.points if points is None else len(points)
    with standing_in(folder) as daemon:
        daemon.start_s = float(int(time.time()) - count)
        if points is None:
            daemon.seconds(count + FLOW_DELAY_S)
        else:
            daemon.commit(real_rows(points, daemon.start_s))
        with page(daemon.socket) as site, opened() as browser, Watched(browser) as watched:
            shown_s, moved_s, from_start_s, moves_s = [], [], [], []
            for _ in range(5):
                watched.page.goto(site + "/history?map=all")
                watched.wait(f"document.querySelector('#map canvas')?.dataset.points === '{count}'", 300.0)
                shown_ms = watched.evaluate("performance.now()")
                canvas = watched.page.locator("#map canvas")
                canvas.focus()
                for _ in range(5):
                    before = watched.evaluate(_DRAWN)
                    began_s = time.monotonic()
                    watched.page.keyboard.press("ArrowLeft")
                    watched.wait(f"{_DRAWN} > {before}")
                    moves_s.append(time.monotonic() - began_s)
                    if len(moves_s) % 5 == 1:
                        moved_ms = watched.evaluate("performance.now()")
                loaded_ms = watched.evaluate("performance.getEntriesByType('navigation')[0].loadEventEnd")
                shown_s.append((shown_ms - loaded_ms) / 1000.0)
                moved_s.append((moved_ms - loaded_ms) / 1000.0)
                from_start_s.append(shown_ms / 1000.0)
    figures = {
        "points": count, "real": points is not None, "shown_after_load_s": [round(x, 3) for x in shown_s],
        "moved_after_load_s": [round(x, 3) for x in moved_s], "shown_after_start_s": [round(x, 3) for x in from_start_s],
        "move_median_s": round(statistics.median(moves_s), 3), "move_largest_s": round(max(moves_s), 3),
    }  # fmt: skip
    return figures, max(moved_s) < MAP_S and max(moves_s) < MAP_S


def real_points(paths: Sequence[Path], count: int) -> Points:
    """Longitude, latitude and flow of the points of harvests that have flow, each harvest moved to the east of the one before."""
    parts: list[Points] = []
    east_deg = HOME[1]
    for path in paths:
        columns = sources.read(path, ReadOptions()).columns
        part = np.column_stack([columns[name] for name in ("longitude_deg", "latitude_deg", "flow_kg_s")])
        part = part[np.isfinite(part).all(axis=1) & (part[:, 2] > 0.0)]
        part[:, 0] += east_deg - part[:, 0].min()
        part[:, 1] += HOME[0] - part[:, 1].min()
        east_deg = float(part[:, 0].max()) + 1e-3
        parts.append(part)
    return np.concatenate(parts)[:count]


def real_rows(points: Points, start_s: float) -> tuple[SecondRow, ...]:
    """Seconds whose flow, moved back by the page's delay, is that of each point."""
    rows = []
    for number in range(len(points) + FLOW_DELAY_S):
        place = points[min(number, len(points) - 1)]
        flow = float(points[max(0, number - FLOW_DELAY_S), 2])
        where: dict[str, Any] = {"longitude_deg": float(place[0]), "latitude_deg": float(place[1])}
        rows.append(replace(row(number + 1, start_s), **where, mass_flow_kg_s=flow, mass_kg=flow))
    return tuple(rows)


def faults(folder: Path, options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """The stand-in makes its answer anew each second, as the daemon does; a fault comes with one of them."""
    with standing_in(folder) as daemon:
        daemon.seconds(60)
        waits_s = []
        with live_page(daemon) as watched:
            for number in range(options.count):
                watched.page.wait_for_timeout(1000 + 137 * (number % 8))
                daemon.seconds(1)
                daemon.faults = [fault(f"Fault{number}")]
                began_s = time.monotonic()
                watched.wait(f"document.querySelector('.fault strong')?.textContent === 'Fault{number}'")
                waits_s.append(time.monotonic() - began_s)
    figures = {"count": len(waits_s), "median_s": round(statistics.median(waits_s), 3), "largest_s": round(max(waits_s), 3)}
    return figures, max(waits_s) < FAULT_S


def cost(folder: Path, options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Turn about, so that other work on the machine meets both alike."""
    import can

    from tests.robustness.daemon_cost import GROUP, PORT, ROOT, WARM_UP_S, Player, cpu_time_s, traffic
    from yieldmon.service.operator.control_client import ask
    from yieldmon.service.operator.control_protocol import ControlError

    turns = 6
    bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
    (folder / "c.yaml").write_text(json.dumps({"bus": bus}))
    messages = traffic(WARM_UP_S + turns * options.seconds + 1.0)
    environment = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    socket = folder / "yieldmon.sock"
    command = [sys.executable, "-m", "yieldmon", "run", "--config", str(folder / "c.yaml")]
    shares: dict[str, list[float]] = {"without": [], "with": []}
    with subprocess.Popen(command, cwd=ROOT, env=environment) as daemon:
        try:
            for _ in range(600):
                try:
                    ask(socket, {"command": "status"})
                    break
                except ControlError:
                    time.sleep(0.1)
            with can.Bus(GROUP, interface="udp_multicast", port=PORT) as sender:
                player = Player(sender, messages)
                player.play(WARM_UP_S, filler=False)
                for turn in range(turns):
                    kind = ("without", "with")[turn % 2]
                    with ExitStack() as stack:
                        if kind == "with":
                            site = stack.enter_context(page(socket))
                            for _ in range(PAGES):
                                watch(stack, site)
                        before_s, cpu_s = time.monotonic(), cpu_time_s(daemon.pid)
                        player.play(options.seconds, filler=False)
                        shares[kind].append(100.0 * (cpu_time_s(daemon.pid) - cpu_s) / (time.monotonic() - before_s))
        finally:
            daemon.terminate()
    rise_pct = statistics.mean(shares["with"]) - statistics.mean(shares["without"])
    rounded = {name: [round(share, 2) for share in found] for name, found in shares.items()}
    return {"pages": PAGES, "core_share_pct": rounded, "rise_pct": round(rise_pct, 2)}, rise_pct <= COST_PCT


def watch(stack: ExitStack, site: str) -> None:
    """A page's stream of events, read on a thread until the stack ends."""
    stream = stack.enter_context(urllib.request.urlopen(f"{site}/api/live"))

    def read() -> None:
        try:
            while stream.readline():
                pass
        except (OSError, ValueError, AttributeError):
            # Closed under it, at the end.
            return

    threading.Thread(target=read, daemon=True).start()


if __name__ == "__main__":
    sys.exit(main())
