"""One life of a daemon for the crash test: measures at many times real speed until it is killed.

Prints a line for each window that closed ("closed NUMBER") and each batch that the store reported as written ("committed
NUMBER TOTAL").
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from yieldmon.bus.log_files import mf4

# python-can would import asammdf, and with it pandas: a third of a life's start.
mf4.defer()

import can  # noqa: E402

from tests.service.bench import CODEC, START_S, traffic  # noqa: E402
from yieldmon.service.config import configuration  # noqa: E402
from yieldmon.service.daemon import Daemon  # noqa: E402
from yieldmon.service.storage.batch import Batch  # noqa: E402
from yieldmon.service.storage.store import Store  # noqa: E402
from yieldmon.service.timeouts import Timeouts  # noqa: E402

#: As long as a slow drive takes for a transaction, so that kills fall between the two.
BETWEEN_S = 0.02


def say(*words: object) -> None:
    """One write(2) a line, so that a kill never leaves half of one behind."""
    os.write(1, (" ".join(map(str, words)) + "\n").encode())


class UnsyncedStore(Store):
    """Does not wait for the medium."""

    def _prepare(self) -> None:
        super()._prepare()
        self._database.execute("PRAGMA synchronous = OFF")


class SplitStore(Store):
    """Puts the records into one transaction and the state that belongs to them into another."""

    def commit(self, batches: Sequence[Batch]) -> None:
        for batch in batches:
            before = self.state()
            if before is not None:
                super().commit([replace(batch, number=2 * batch.number, state=before)])
                time.sleep(BETWEEN_S)
                batch = replace(batch, seconds=(), faults=(), sweeps=(), tickets=())  # noqa: PLW2901 - what is left of it
            super().commit([replace(batch, number=2 * batch.number + 1)])


class TwiceStore(Store):
    """Tells a monitor that goes on from it of a second more than it holds."""

    def state(self) -> dict[str, Any] | None:
        state, last = super().state(), self.last_second()
        if state is not None and last is not None:
            state["engine"]["totals"]["total_kg"] += last.mass_kg
        return state


#: Stores that are wrong on purpose, by the name of how.
BROKEN: Mapping[str, type[Store]] = {"": Store, "unsynced": UnsyncedStore, "split": SplitStore, "twice": TwiceStore}


def live(folder: Path, seconds: int, broken: str = "") -> None:
    """Runs until killed, or for so many seconds of bus time. broken: a name of BROKEN."""
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    (folder / "c.yaml").write_text("sweep: {enabled: false}\nbus: {transmit_max_age_s: 60}\n")

    chosen: Any = BROKEN[broken]

    class TellingStore(chosen):  # type: ignore[misc]
        def commit(self, batches: Sequence[Batch]) -> None:
            super().commit(batches)
            rows = [row for batch in batches for row in batch.seconds]
            if rows:
                say("committed", rows[-1].number, repr(rows[-1].total_kg))

    loaded = configuration.load(folder / "c.yaml", environment)
    daemon = Daemon(
        loaded,
        environment=environment,
        bus_factory=lambda: can.Bus(interface="virtual", channel="life"),
        timeouts=Timeouts(silence_s=float("inf")),
    )
    daemon._store.open = lambda: TellingStore(loaded.store_path, loaded.retention)  # type: ignore[method-assign]
    daemon.writer._open_store = daemon._store.open
    submit = daemon.writer.submit
    closed: list[int] = []

    def telling_submit(batch: Batch) -> None:
        if batch.seconds:
            say("closed", batch.seconds[-1].number)
        submit(batch)
        # Only now: whoever waits for it also waits for the batch to be written.
        closed.extend(row.number for row in batch.seconds)

    daemon.writer.submit = telling_submit  # type: ignore[method-assign]
    thread = threading.Thread(target=daemon.run)
    thread.start()
    daemon.started.wait()
    peer = can.Bus(interface="virtual", channel="life", preserve_timestamps=True)
    now_s = START_S
    with peer:
        for second in range(seconds):
            force_mv = 0.0 if daemon.monitor.snapshot().zero is None else 60.0
            for frame in traffic(now_s, 1.0, force_mv):
                peer.send(CODEC.encode(frame))
            now_s += 1.0
            # In real time the store is done long before the next second; here it has to be waited for.
            while len(closed) < second or daemon.writer.health().pending:
                thread.join(0.0005)
    daemon.request_stop()
    thread.join()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=int, default=100_000)
    parser.add_argument("--broken", choices=list(BROKEN), default="")
    args = parser.parse_args()
    live(args.folder, args.seconds, args.broken)
