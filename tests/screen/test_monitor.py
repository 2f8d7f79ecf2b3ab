"""The frame monitor: counts, rates and ages; the screen on a fake terminal; keys; the verb on a real pseudo-terminal."""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import can
import pytest
from rich.console import Console

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.cli.main import main
from yieldmon.frames import Frame
from yieldmon.screen.keys import press
from yieldmon.screen.panels import Screen, View
from yieldmon.screen.traffic import Traffic

ROOT = Path(__file__).parents[2]
CODEC = Codec()
FAULTS = {s.name: 0 for s in CODEC.layouts[frames.YIELD_MONITOR_STATUS].signals}


def speed(time_s: float, rpm: float = 400.0) -> can.Message:
    return CODEC.encode(Frame(time_s, frames.ELEVATOR_SPEED, {"ElevatorSpeed": rpm}))


def flow(time_s: float, rate: float, quality: int = 0) -> can.Message:
    signals = {"MassFlowRate": rate, "MassFlowStdDev": 0.25, "EstimateQuality": quality, "WindowCounter": 7}
    return CODEC.encode(Frame(time_s, frames.MASS_FLOW, signals))


def status(time_s: float, **on: int) -> can.Message:
    return CODEC.encode(Frame(time_s, frames.YIELD_MONITOR_STATUS, FAULTS | {"OperatingState": 3} | on))


def foreign(time_s: float, arbitration_id: int = 0x123) -> can.Message:
    return can.Message(timestamp=time_s, arbitration_id=arbitration_id, is_extended_id=False, data=b"\x01\xff")


def watched(messages: list[can.Message], marks_s: list[float]) -> Traffic:
    traffic = Traffic(CODEC)
    pending = sorted(messages, key=lambda m: m.timestamp)
    for mark in marks_s:
        while pending and pending[0].timestamp <= mark:
            traffic.observe(pending.pop(0))
        traffic.mark(mark)
    return traffic


def drawn(traffic: Traffic, view: View | None = None, width: int = 80, height: int = 24) -> list[str]:
    console = Console(
        file=io.StringIO(), width=width, height=height, force_terminal=True, color_system=None, legacy_windows=False
    )
    console.print(Screen(traffic, view or View()), height=height)
    return console.file.getvalue().splitlines()


def test_counts_are_exact_and_rates_are_those_of_the_frames():
    messages = [speed(0.1 * i) for i in range(1, 101)] + [foreign(0.004 * i) for i in range(1, 2501)]
    traffic = watched(messages, [0.25 * i for i in range(1, 41)])
    by_name = {row.name: row for row in traffic.rows.values()}
    assert by_name[frames.ELEVATOR_SPEED].count == 100
    assert by_name[""].count == 2500
    assert by_name[frames.ELEVATOR_SPEED].rate_hz(10.0) == pytest.approx(10.0, rel=0.02)
    assert by_name[""].rate_hz(10.0) == pytest.approx(250.0, rel=0.01)
    assert traffic.frames == 2600


@pytest.mark.parametrize(("age_s", "stale"), [(0.5, False), (0.99, False), (1.01, True)])
def test_a_row_is_stale_after_ten_periods(age_s, stale):
    traffic = watched([speed(0.1 * i) for i in range(1, 31)], [1.0, 2.0, 3.0])
    (row,) = traffic.rows.values()
    assert row.is_stale(3.0 + age_s) is stale


OWN_DBC = """\
VERSION ""
BU_: Node
BO_ 401 Cell: 8 Node
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" Node
 SG_ Left m0 : 15|16@0- (0.01,-5) [0|0] "N" Node
 SG_ Right m1 : 15|16@0- (0.01,-5) [0|0] "N" Node
 SG_ Heat : 32|32@1- (1,0) [0|0] "degC" Node
BO_ 2566848784 Shaft: 4 Node
 SG_ Pulses : 0|16@1+ (1,0) [0|0] "" Node
 SG_ Turns : 16|16@1+ (0.125,0) [0|0] "rpm" Node
BO_ 402 Wide: 64 Node
 SG_ Last : 496|16@1+ (0.5,0) [0|0] "mV" Node
SIG_VALTYPE_ 401 Heat : 1;
VAL_ 2566848784 Turns 65535 "SNA" ;
"""


def test_messages_of_a_makers_dbc_are_decoded(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "own.dbc").write_text(OWN_DBC)
    frames_sent = (
        (401, False, struct.pack(">BhxI", 0, -2500, 0)),
        (401, False, struct.pack(">Bhx", 1, 12_345) + struct.pack("<f", 21.25)),
        (0x18FF0177, True, struct.pack("<HH", 4711, 0xFFFF)),
        (402, False, bytes(62) + struct.pack("<H", 1001)),
        (403, False, b"\x01"),
    )
    with can.Logger(str(tmp_path / "own.log")) as logger:
        for place, (identifier, extended, data) in enumerate(frames_sent):
            logger.on_message_received(
                can.Message(1.79e9 + 0.01 * place, identifier, extended, is_fd=len(data) > 8, data=data, channel="can0")
            )
    words = ["monitor", str(tmp_path / "own.log"), "--once", "--speed", "0", "--dbc", str(tmp_path / "own.dbc")]
    assert main([*words, "--json"]) == 0
    rows = {row["id"]: (row["message"], row["signals"]) for row in json.loads(capsys.readouterr().out)["rows"]}
    assert rows == {
        "191": ("Cell", {"Page": 1, "Left": None, "Right": pytest.approx(118.45), "Heat": 21.25}),
        "18FF0177": ("Shaft", {"Pulses": 4711, "Turns": None}),
        "192": ("Wide", {"Last": 500.5}),
        "193": (None, None),
    }
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert all(part in shown for part in ("Cell 191, 8 bytes", "21.25 degC", "on: Page", "18FF0177 Shaft"))


def test_error_frames_are_counted_and_make_no_row():
    traffic = Traffic(CODEC)
    traffic.observe(can.Message(timestamp=1.0, is_error_frame=True, arbitration_id=0x40, dlc=8))
    assert (traffic.error_frames, traffic.frames, traffic.rows) == (1, 0, {})


def test_the_screen_shows_flow_quality_faults_and_every_frame():
    traffic = watched([speed(1.0), flow(1.0, 12.3), status(1.0, SensorStuck=1), foreign(1.0)], [1.1])
    text = "\n".join(drawn(traffic, width=120))
    for expected in ("0.25 kg/s", "harvesting", "faults: SensorStuck", "ElevatorSpeed  400.0 rpm", "01 FF", "123"):
        assert expected in text
    assert "█" in text


def test_old_flow_is_never_shown_as_a_figure():
    traffic = watched([flow(1.0, 12.3)], [1.0, 20.0])
    text = "\n".join(drawn(traffic))
    assert "stale, 19 s old" in text
    assert "█" not in text.split("id")[0].splitlines()[0]


def test_not_harvesting_is_not_a_flow_of_zero():
    signals = {
        "MassFlowRate": frames.NOT_AVAILABLE,
        "MassFlowStdDev": frames.NOT_AVAILABLE,
        "EstimateQuality": 1,
        "WindowCounter": 1,
    }
    traffic = watched([CODEC.encode(Frame(1.0, frames.MASS_FLOW, signals))], [1.0])
    text = "\n".join(drawn(traffic))
    assert "not harvesting" in text
    assert list(traffic.flow_kg_s) == [None]


@pytest.mark.parametrize(("width", "height"), [(80, 24), (60, 12), (200, 60)])
def test_the_screen_fits_the_terminal(width, height):
    messages = [foreign(1.0, i) for i in range(0x100, 0x140)] + [flow(1.0, 3.0), status(1.0)]
    lines = drawn(watched(messages, [1.0]), width=width, height=height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= width


def test_rows_stay_in_place_while_frames_come_in():
    first = [foreign(1.0, i) for i in range(0x100, 0x108)]
    later = first + [foreign(1.0 + 0.01 * i, 0x103) for i in range(50)]

    def order(messages: list[can.Message]) -> list[str]:
        return [line[1:].split()[0] for line in drawn(watched(messages, [2.0])) if re.match(r".10\d ", line)]

    assert order(first) == order(later) == [f"{i:X}" for i in range(0x100, 0x108)]


@pytest.mark.parametrize(
    ("pressed", "expected"),
    [
        (" ", {"paused": True}),
        ("s", {"order": "name"}),
        ("ssss", {"order": "id"}),
        ("jj", {"selected": 2}),
        ("jkk", {"selected": 0}),
        ("c", {"cab": True}),
        ("cc", {"cab": False}),
        ("/mass\r", {"needle": "mass", "typing": False}),
        ("/mass\x7f\x7f", {"needle": "ma", "typing": True}),
        ("/mass\x1b", {"needle": "", "typing": False}),
        ("/q", {"needle": "q", "typing": True}),
    ],
)
def test_keys(pressed, expected):
    view = View()
    assert all(press(view, key) is None for key in pressed)
    assert {name: getattr(view, name) for name in expected} == expected


@pytest.mark.parametrize(("key", "act"), [("q", "quit"), ("\x03", "quit"), ("r", "record")])
def test_keys_that_the_caller_acts_on(key, act):
    assert press(View(), key) == act


def test_the_filter_keeps_rows_by_name_or_identifier():
    traffic = watched([speed(1.0), flow(1.0, 2.0), foreign(1.0)], [1.0])
    assert [r.name for r in traffic.sorted_rows("id", "massflow")] == [frames.MASS_FLOW]
    assert [r.key[0] for r in traffic.sorted_rows("id", "123")] == [0x123]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "drive.log"
    with can.Logger(path) as logger:
        for i in range(1, 41):
            logger.on_message_received(speed(0.1 * i))
            if i % 10 == 0:
                logger.on_message_received(flow(0.1 * i, 10.0 + i))
    return path


def test_once_as_json_from_a_log(log, capsys):
    assert main(["monitor", str(log), "--once", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    rows = {row["message"]: row for row in document["rows"]}
    assert document["frames"] == 44
    assert rows["ElevatorSpeed"]["count"] == 40
    assert rows["MassFlow"]["signals"]["MassFlowRate"] == pytest.approx(50.0)


def test_once_as_a_screen_from_a_log(log, capsys):
    assert main(["monitor", str(log), "--once"]) == 0
    assert "ElevatorSpeed" in capsys.readouterr().out


def test_json_lines_from_a_log_at_speed(log, capsys):
    assert main(["monitor", str(log), "--json", "--speed", "4"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["frames"] for line in lines] == sorted(line["frames"] for line in lines)
    assert lines


def test_json_lines_end_with_all_that_the_log_holds(log, capsys):
    assert main(["monitor", str(log), "--json", "--speed", "0"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["frames"] == 44


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_a_terminal_of_any_encoding_shows_the_flow(encoding, log):
    environment = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "yieldmon", "monitor", str(log), "--once"]
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    shown = done.stdout.decode(encoding)
    head = shown.split("message")[0]
    assert ("50.0" if encoding != "utf-8" else "\u2588\u2580\u2580 \u2588\u2580\u2588") in head
    assert "?" not in head


@pytest.mark.parametrize("option", ["--speed", "--seconds"])
@pytest.mark.parametrize("value", ["nan", "-1", "inf"])
def test_a_number_that_is_none_is_refused(option, value, log, capsys):
    assert main(["monitor", str(log), "--once", option, value]) == 2
    assert f"{option}: is {value}" in capsys.readouterr().err


@pytest.mark.parametrize("how", [["--once"], ["--once", "--json"], ["--json"]])
def test_a_log_without_a_frame_is_refused(how, tmp_path, capsys):
    path = tmp_path / "empty.log"
    path.write_text("")
    assert main(["monitor", str(path), *how]) == 2
    assert capsys.readouterr() == ("", f"yieldmon: {path}: no frame at all; expected a log with frames\n")


def test_a_screen_without_a_terminal_is_refused(log, capsys):
    assert main(["monitor", str(log)]) == 2
    expected = "yieldmon: standard output: is not a terminal; expected a terminal, --once, --json or --record F\n"
    assert capsys.readouterr() == ("", expected)


def test_recording_writes_every_frame(log, tmp_path, capsys):
    copy = tmp_path / "copy.asc"
    assert main(["monitor", str(log), "--once", "--record", str(copy)]) == 0
    assert sum(1 for _ in can.LogReader(copy)) == 44


def test_a_recording_takes_no_other_ones_name(log, tmp_path, monkeypatch):
    """A clock that is set back, or the hour that comes twice in autumn, says the same time again."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.strftime", lambda _: "yieldmon-20261025-023000")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    pressed = ["rrr"]
    monkeypatch.setattr("yieldmon.screen.keys.waiting", lambda: pressed.pop() if pressed else "")
    kept = tmp_path / "yieldmon-20261025-023000.log"
    kept.write_text("kept\n")
    assert main(["monitor", str(log), "--speed", "4"]) == 0
    assert kept.read_text() == "kept\n"
    names = sorted(path.name for path in tmp_path.glob("yieldmon-*"))
    assert names == ["yieldmon-20261025-023000-2.log", "yieldmon-20261025-023000-3.log", "yieldmon-20261025-023000.log"]


def test_a_recording_that_is_ended_is_whole_at_once(log, tmp_path, monkeypatch):
    """And not only when the program ends."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    # Twenty seconds of log, of which two are recorded: a busy machine may take longer over a refresh.
    keys, found = iter(["r", *[""] * 8, "r"]), []

    def waiting() -> str:
        if (key := next(keys, None)) is not None:
            return key
        found.extend(path.read_bytes() for path in tmp_path.glob("yieldmon-*.log"))
        return "q"

    monkeypatch.setattr("yieldmon.screen.keys.waiting", waiting)
    assert main(["monitor", str(log), "--speed", "0.2"]) == 0
    assert found == [path.read_bytes() for path in tmp_path.glob("yieldmon-*.log")]
    assert len(found[0].splitlines()) > 1


@pytest.mark.parametrize(
    "arguments", [["missing.log", "--once"], ["--record", "x.unknown", "--once", "LOG"], ["LOG", "--speed", "-1"]]
)
def test_bad_arguments_are_one_line(arguments, log, capsys):
    assert main(["monitor", *(str(log) if a == "LOG" else a for a in arguments)]) == 2
    assert capsys.readouterr().err.strip().count("\n") == 0


class Terminal:
    """yieldmon on a pseudo-terminal of 80 columns and 24 lines."""

    def __init__(self, *words: str, **environment: str) -> None:
        self.seen = b""
        self._deadline = time.monotonic() + 60.0
        self._child, self._master = pty.fork()
        if self._child == 0:
            kept = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
            # The size is set by the parent, which may come later than the program's start: it waits for the first byte.
            os.read(0, 1)
            # A shell's background job has it ignored, and what it starts inherits that.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.execve(sys.executable, [sys.executable, "-m", "yieldmon", *words], kept | {"TERM": "xterm-256color"} | environment)
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        os.write(self._master, b"\n")

    def until(self, text: bytes) -> None:
        """Reads until the text has come."""
        while text not in self.seen:
            assert time.monotonic() < self._deadline, self.seen
            if select.select([self._master], [], [], 1.0)[0]:
                self.seen += os.read(self._master, 65536)

    def press(self, key: bytes) -> None:
        os.write(self._master, key)

    def exit_code(self) -> int:
        """Reads on until the program has ended."""
        while time.monotonic() < self._deadline:
            if select.select([self._master], [], [], 0.1)[0]:
                try:
                    self.seen += os.read(self._master, 65536)
                except OSError:
                    break
        else:
            os.kill(self._child, signal.SIGKILL)
        return os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])

    def pages(self) -> list[list[str]]:
        """Each screen drawn, as plain lines."""
        plain = (re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", page).decode() for page in self.seen.split(b"\x1b[H")[1:])
        return [page.split("\r\n") for page in plain]


def test_on_a_real_terminal_until_q(log):
    terminal = Terminal("monitor", str(log), "--speed", "0.2")
    terminal.until(b"ElevatorSpeed")
    terminal.press(b"q")
    assert terminal.exit_code() == 0
    for page in terminal.pages():
        assert len(page) <= 24
        assert max(map(len, page)) <= 80
    assert b"\x1b[1;3" in terminal.seen


def test_ctrl_c_on_a_real_terminal(log):
    terminal = Terminal("monitor", str(log), "--speed", "0.2")
    terminal.until(b"ElevatorSpeed")
    terminal.press(b"\x03")
    assert terminal.exit_code() == 130
    assert b"Traceback" not in terminal.seen


def test_ctrl_c_in_a_replay_on_a_real_terminal(log):
    terminal = Terminal("replay", str(log), "-i", "virtual", "-c", "ctrl-c", "--loop")
    terminal.until(b"frames")
    terminal.press(b"\x03")
    assert terminal.exit_code() == 130
    assert b"Traceback" not in terminal.seen


def test_no_colour_on_a_real_terminal(log):
    terminal = Terminal("monitor", str(log), "--once", NO_COLOR="1")
    assert terminal.exit_code() == 0
    assert b"ElevatorSpeed" in terminal.seen
    codes = {code for found in re.findall(rb"\x1b\[([0-9;]*)m", terminal.seen) for code in found.split(b";")}
    assert not {code for code in codes if code[:1] in (b"3", b"4", b"9") and len(code) > 1}


def test_a_key_pressed_while_the_program_starts_counts(log):
    terminal = Terminal("monitor", str(log), "--speed", "0.2")
    terminal.press(b"q")
    assert terminal.exit_code() == 0


@pytest.fixture
def hung(tmp_path):
    """The socket of a daemon that was stopped: the kernel takes connections, nobody answers them."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "hung.sock"))
        listening.listen()
        yield str(tmp_path / "hung.sock")


@pytest.mark.parametrize(
    ("words", "state"), [(["--cab"], b"WAITING FOR THE DAEMON"), (["-i", "virtual"], b"no monitor on the bus")]
)
def test_a_daemon_that_hangs_is_said_on_the_screen(hung, words, state):
    """And not after the ten seconds that an answer may take."""
    terminal = Terminal("monitor", *words, "--socket", hung)
    terminal.until(b"the daemon has not answered for 2 s; if it lasts,")
    assert state in terminal.seen
    terminal.press(b"q")
    assert terminal.exit_code() == 0


def test_once_says_that_the_daemon_hangs(hung, capsys):
    with pytest.raises(SystemExit, match="1"):
        main(["monitor", "--cab", "--once", "--socket", hung])
    assert "the daemon does not answer" in capsys.readouterr().err
    assert main(["monitor", "--cab", "--once", "--socket", hung, "-i", "virtual", "--seconds", "0.1"]) == 0
    assert "the daemon has not answered for" in capsys.readouterr().out
