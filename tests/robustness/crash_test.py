"""Take the power away from a measuring daemon, over and over, and check what its store holds.

--kills 500                 kill -9 at random instants, the store going on from one life to the next
--power-cuts 500            (needs strace) replay the store's own writes up to a random instant, with any of those that were not
                            yet synced lost or torn, as a drive may leave them

Held after every crash: the store opens and a monitor can go on from it; seconds are numbered without a gap and none is there
twice; total = sum of the seconds; totals never run back; all that was reported as committed is there; of the seconds closed at
most the last is lost.

--broken unsynced --power-cuts 100    the same with a store that does not wait for the medium
--broken split --kills 50             ... whose records and state are two transactions
--broken twice --kills 50             ... that counts a second twice after a restart

must report what does not hold, and end with 1.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from tests.robustness import crash_life as crash_test_life
from yieldmon.service.history.memory import recall
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError

ROOT = Path(__file__).resolve().parents[2]
LIFE = ("-m", "tests.robustness.crash_life")


#: Share of the lives that are killed within so many seconds of their start.
EARLY_SHARE, EARLY_S = 0.2, 0.3
#: Stands for the folder among the names of files.
FOLDER = "<folder>"


class Broken(Exception):
    """What must hold does not."""


@dataclass
class Account:
    """What a store holds, checked."""

    seconds: int = 0
    total_kg: float = 0.0


def check(path: Path, least: Account) -> Account:
    """Opens the store as the daemon does and checks it; `least` is what it must hold at least."""
    with Store(path) as store:
        finding = store._pragma("integrity_check")
        if finding != "ok":
            raise Broken(f"integrity: {finding}")
        rows = store.seconds()
        state = store.state()
        loads = store.loads()
        memory = recall(store)
    numbers = [row.number for row in rows]
    if numbers != list(range(1, len(rows) + 1)):
        raise Broken(f"numbers have gaps or repeats: {len(rows)} rows, last {numbers[-1:]}")
    total = 0.0
    for row in rows:
        total += row.mass_kg
        if abs(row.total_kg - total) > 1e-9 * max(1.0, total):
            raise Broken(f"second {row.number}: total {row.total_kg} kg, sum of the seconds {total} kg")
    stored = state["engine"]["totals"]["total_kg"] if state is not None else 0.0
    if rows and abs(stored - rows[-1].total_kg) > 1e-9 * max(1.0, stored):
        raise Broken(f"state has {stored} kg, the last second {rows[-1].total_kg} kg")
    if abs(sum(load.mass_kg for load in loads) - stored) > 1e-9 * max(1.0, stored):
        raise Broken(f"loads sum up to {sum(load.mass_kg for load in loads)} kg, state has {stored} kg")
    if memory.last_second != len(rows) or (memory.engine.totals.total_kg if memory.engine else 0.0) != stored:
        raise Broken(f"a monitor would go on from second {memory.last_second} of {len(rows)}")
    if len(rows) < least.seconds or stored < least.total_kg:
        raise Broken(f"{len(rows)} seconds, {stored} kg; committed before: {least.seconds}, {least.total_kg} kg")
    return Account(len(rows), stored)


def kill_test(kills: int, rng: random.Random, folder: Path, broken: str) -> dict[str, object]:
    """Lives that end by kill -9 at random instants, on one store; some of them before they have measured anything."""
    path = folder / "yieldmon.sqlite"
    least = Account()
    lost_most = early = 0
    for number in range(kills):
        pid, reports = start_life(folder, broken)
        committed, closed = least, least.seconds
        killed = rng.random() < EARLY_SHARE
        if killed:
            # While the store is opened, recovered or made.
            wait_s(rng.random() * EARLY_S)
            os.kill(pid, signal.SIGKILL)
            early += 1
        target = rng.randint(0, 30)
        for count, line in enumerate(reports):
            words = line.split()
            if words[0] == "committed":
                committed = Account(int(words[1]), float(words[2]))
            else:
                closed = max(closed, int(words[1]))
            if count >= target and not killed:
                # A random instant: some way into the next write, not just after a line was printed.
                wait_s(rng.random() * 0.02)
                os.kill(pid, signal.SIGKILL)
                killed = True
        _, status = os.waitpid(pid, 0)
        if not (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
            raise Broken(f"life {number + 1} ended by itself, status {status}")
        if path.exists():
            found = check_copy(path, committed, folder / "copy")
            lost_most = max(lost_most, closed - found.seconds)
            if lost_most > 1:
                raise Broken(f"{lost_most} closed seconds are lost")
            least = found
        if number % 50 == 49:
            print(f"{number + 1} kills, {least.seconds} seconds, {least.total_kg:.1f} kg", file=sys.stderr)
    return {
        "kills": kills,
        "of_these_at_the_start": early,
        "seconds": least.seconds,
        "total_kg": least.total_kg,
        "closed_but_not_committed_at_most": lost_most,
    }


def wait_s(duration_s: float) -> None:
    """Lets so much time pass."""
    signal.sigtimedwait([], duration_s)


def check_copy(path: Path, least: Account, folder: Path) -> Account:
    """Checks a copy, so that it is the next life that has to put right what the last one left."""
    folder.mkdir()
    for part in path.parent.glob(f"{path.name}*"):
        shutil.copy(part, folder / part.name)
    found = check(folder / path.name, least)
    shutil.rmtree(folder)
    return found


def start_life(folder: Path, broken: str) -> tuple[int, IO[str]]:
    """A daemon in a process of its own, and its reports line by line."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.dup2(write, 1)
        os.closerange(3, 256)
        crash_test_life.live(folder, 100_000, broken)
        os._exit(1)
    os.close(write)
    return pid, os.fdopen(read)


@dataclass
class Write:
    """One change of a file, and the syncs that came before it."""

    name: str
    kind: str
    offset: int = 0
    data: bytes = b""
    reported: Account | None = None


@dataclass
class Disk:
    """Files as they are for sure, and the writes that are not yet synced."""

    durable: dict[str, bytearray] = field(default_factory=dict)
    unsynced: list[Write] = field(default_factory=list)

    def sync(self, name: str) -> None:
        """Everything written to the file so far is on the medium; for the folder: every file that was taken away."""
        waiting = []
        for write in self.unsynced:
            if write.name == name or (name == FOLDER and write.kind == "unlink"):
                apply(self.durable, write)
            else:
                waiting.append(write)
        self.unsynced = waiting

    def after_power_cut(self, rng: random.Random) -> dict[str, bytearray]:
        """What is left: any of the unsynced writes may be there, be missing, or be there in part, sector by sector."""
        files = {name: bytearray(content) for name, content in self.durable.items()}
        for write in self.unsynced:
            fate = rng.random()
            if fate < 0.4:
                apply(files, write)
            elif fate < 0.6 and write.kind == "write":
                for start in range(0, len(write.data), 512):
                    if rng.random() < 0.5:
                        apply(files, Write(write.name, "write", write.offset + start, write.data[start : start + 512]))
        return files


def apply(files: dict[str, bytearray], write: Write) -> None:
    """Carries a write out."""
    if write.kind == "unlink":
        files.pop(write.name, None)
        return
    content = files.setdefault(write.name, bytearray())
    if write.kind == "truncate":
        del content[write.offset :]
        content.extend(b"\0" * (write.offset - len(content)))
    elif write.kind == "write":
        if len(content) < write.offset:
            content.extend(b"\0" * (write.offset - len(content)))
        content[write.offset : write.offset + len(write.data)] = write.data


CALL = re.compile(r"^(?:\d+ +)?(\w+)\((.*)\) += (-?\d+)")
TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')


def unhex(text: str) -> bytes:
    return bytes.fromhex(text.replace("\\x", ""))


def calls_in(path: Path) -> Iterator[tuple[str, str, int]]:
    """Name, arguments and result of each system call that succeeded, those of several threads put together again."""
    unfinished: dict[str, str] = {}
    for line in path.read_text(errors="replace").splitlines():
        pid, _, rest = line.partition(" ")
        rest = rest.strip()
        if rest.endswith("<unfinished ...>"):
            unfinished[pid] = rest.removesuffix("<unfinished ...>").rstrip()
            continue
        if rest.startswith("<... "):
            rest = unfinished.pop(pid, "") + rest.partition("resumed>")[2]
        match = CALL.match(rest)
        if match is not None and int(match[3]) >= 0:
            yield match[1], match[2], int(match[3])


def parse_trace(path: Path, folder: Path) -> list[Write]:
    """The writes, truncations and syncs that strace saw on the store's files, and the life's own reports, in order."""
    names: dict[int, str] = {}
    writes: list[Write] = []
    for call, arguments, result in calls_in(path):
        if call == "openat":
            name = unhex(TEXT.search(arguments).group(1)).decode()  # type: ignore[union-attr]
            if name == str(folder):
                names[result] = FOLDER
            elif name.startswith(str(folder)) and "yieldmon.sqlite" in name and not name.endswith("-shm"):
                names[result] = Path(name).name
            else:
                names.pop(result, None)
            continue
        if call == "unlink":
            name = Path(unhex(TEXT.search(arguments).group(1)).decode()).name  # type: ignore[union-attr]
            writes.append(Write(name, "unlink"))
            continue
        descriptor = int(arguments.partition(",")[0])
        if call == "write" and descriptor == 1:
            words = unhex(TEXT.search(arguments).group(1)).decode().split()  # type: ignore[union-attr]
            if words[0] == "committed":
                writes.append(Write("", "report", reported=Account(int(words[1]), float(words[2]))))
        elif descriptor in names:
            name = names[descriptor]
            if call == "pwrite64":
                data = unhex(TEXT.search(arguments).group(1))  # type: ignore[union-attr]
                writes.append(Write(name, "write", int(arguments.rpartition(",")[2]), data))
            elif call == "ftruncate":
                writes.append(Write(name, "truncate", int(arguments.rpartition(",")[2])))
            elif call in ("fsync", "fdatasync"):
                writes.append(Write(name, "sync"))
    return writes


def power_cut_test(cuts: int, rng: random.Random, folder: Path, broken: str, life_s: int) -> dict[str, object]:
    """One life under strace; power cuts at random places of its writes."""
    trace = folder / "trace"
    calls = "openat,pwrite64,write,ftruncate,fsync,fdatasync,unlink"
    subprocess.run(
        [
            "strace", "-f", "--seccomp-bpf", "-xx", "-s", "100000", "-e", f"trace={calls}", "-o", str(trace),
            sys.executable, *LIFE, str(folder), "--seconds", str(life_s), "--broken", broken,
        ],
        check=True, stdout=subprocess.DEVNULL, cwd=ROOT,
    )  # fmt: skip
    writes = parse_trace(trace, folder)
    places = sorted(rng.choices(range(len(writes) + 1), k=cuts))
    disk, least, done = Disk(), Account(), 0
    opened = 0
    for index, write in enumerate([*writes, Write("", "end")]):
        while done < len(places) and places[done] == index:
            opened += check_power_cut(disk.after_power_cut(rng), least, folder / f"cut-{done}")
            done += 1
        if write.kind == "report":
            least = write.reported or least
        elif write.kind == "sync":
            disk.sync(write.name)
        elif write.kind != "end":
            disk.unsynced.append(write)
    return {"power_cuts": cuts, "writes": len(writes), "stores_opened": opened, "seconds": least.seconds}


def check_power_cut(files: dict[str, bytearray], least: Account, folder: Path) -> int:
    """Checks what a power cut left; 1 when there was a store."""
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    found = (folder / "yieldmon.sqlite").exists()
    if found or least.seconds:
        try:
            check(folder / "yieldmon.sqlite", least)
        except (StoreError, sqlite3.Error) as error:
            raise Broken(f"cannot be read; committed before: {least.seconds}, {least.total_kg} kg: {error}") from error
    shutil.rmtree(folder)
    return int(found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when everything held."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness crash-test", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--power-cuts", type=int, default=0)
    parser.add_argument("--life", type=int, default=150, metavar="S", help="bus time of the life whose power is cut")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--broken", choices=list(crash_test_life.BROKEN), default="", metavar="HOW")
    args = parser.parse_args(arguments)
    rng = random.Random(args.seed)
    result: dict[str, object] = {"seed": args.seed}
    with tempfile.TemporaryDirectory(prefix="yieldmon-crash-") as name:
        folder = Path(name)
        try:
            if args.kills:
                (folder / "kills").mkdir()
                result |= kill_test(args.kills, rng, folder / "kills", args.broken)
            if args.power_cuts:
                (folder / "cuts").mkdir()
                result |= power_cut_test(args.power_cuts, rng, folder / "cuts", args.broken, args.life)
        except (Broken, StoreError, sqlite3.Error) as error:
            if not args.broken:
                kept = Path(tempfile.mkdtemp(prefix="yieldmon-crash-kept-"))
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                print(f"files kept in {kept}", file=sys.stderr)
            print(f"{error}; seed {args.seed}", file=sys.stderr)
            return 1
    print(json.dumps(result))
    return 0
