"""Ctrl-C as a terminal sends it, a signal to the whole process group: exit code 130, one line, no half files."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests import forked
from tests.service.bench import CODEC, START_S, traffic

ROOT = Path(__file__).parents[2]
LIMIT_S = 60.0
#: Shells start background jobs with the signal ignored, and what they start inherits that.
INTERRUPTIBLE = "import os, signal; os.setsid(); signal.signal(signal.SIGINT, signal.default_int_handler)"


def lines(duration_s: float) -> bytes:
    """Nominal traffic as candump writes it."""
    messages = (CODEC.encode(frame) for frame in traffic(START_S, duration_s, 0.0))
    text = (f"({m.timestamp:.6f}) can0 {m.arbitration_id:08X}#{bytes(m.data).hex().upper()}\n" for m in messages)
    return "".join(text).encode()


@pytest.fixture
def endless(tmp_path):
    """A log that never ends: a pipe filled as fast as it is read, and an event set once more is read than a pipe holds."""
    path, taken, over = tmp_path / "endless.log", threading.Event(), threading.Event()
    os.mkfifo(path)
    piece = lines(2.0) * 8

    def fill() -> None:
        try:
            with path.open("wb", buffering=0) as pipe:
                while not over.is_set():
                    pipe.write(piece)
                    taken.set()
        except BrokenPipeError:
            pass

    thread = threading.Thread(target=fill, daemon=True)
    thread.start()
    yield path, taken
    over.set()
    thread.join(LIMIT_S)


@pytest.mark.parametrize("words", [["t.csv"], ["t.parquet", "--jobs", "1"]], ids=["ahead", "alone"])
def test_process_interrupted(words, endless, tmp_path):
    log, taken = endless
    folder = tmp_path / "out"
    folder.mkdir()
    command = ["process", str(log), "--out", str(folder / words[0]), *words[1:]]
    with forked.running(*command, before=INTERRUPTIBLE) as running:
        assert taken.wait(LIMIT_S)
        os.killpg(running.pid, signal.SIGINT)
        assert select.select([running.stderr], [], [], LIMIT_S)[0], "it goes on"
        assert (running.rest(), running.wait()) == (f"yieldmon: interrupted; {folder / words[0]} is not written\n", 130)
    assert list(folder.iterdir()) == [], "a table under way leaves nothing"


def test_a_reader_whose_parent_was_killed_ends(endless, tmp_path):
    log, taken = endless
    command = [sys.executable, "-m", "yieldmon", "process", str(log), "--out", str(tmp_path / "t.csv")]
    running = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE)
    assert taken.wait(LIMIT_S)
    running.kill()
    # The pipe ends only when the last process that holds it has ended.
    assert running.communicate(timeout=LIMIT_S)[1] == b""


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (signal.SIGINT, 130, "yieldmon: interrupted; {out} holds the tables of 0 logs\n"),
        (signal.SIGKILL, 1, "yieldmon: {log}: its process was killed, perhaps because memory ran out\n"),
    ],
    ids=["Ctrl-C", "one killed"],
)
def test_logs_measured_separately(endless, tmp_path, number, code, said):
    log, taken = endless
    out, short = tmp_path / "out", tmp_path / "short.log"
    short.write_bytes(lines(4.0))
    with forked.running(
        "process", str(log), str(short), "--separate", "--jobs", "2", "--out", str(out), before=INTERRUPTIBLE
    ) as running:
        assert taken.wait(LIMIT_S)
        if number == signal.SIGINT:
            os.killpg(running.pid, number)
        else:
            children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
            os.kill(int(children.read_text().split()[0]), number)
        assert select.select([running.stderr], [], [], LIMIT_S)[0], "it goes on"
        assert (running.rest(), running.wait()) == (said.format(out=out, log=log), code)
    # One that is killed, or ended while it compiles, can put nothing away.
    left = {path.name for path in out.iterdir() if ".unfinished-" not in path.name}
    assert left <= {"short.csv"}
