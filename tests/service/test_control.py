"""The daemon's local socket: who may use it, and what a bad request gets."""

from __future__ import annotations

import errno
import grp
import json
import os
import pwd
import selectors
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from time import sleep
from typing import Any

import pytest

from tests.service.bench import wait_for
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.service.operator.control import PACE, ControlServer, Pace
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import MAX_REQUEST_BYTES, ControlError

SOON = Pace(timeout_s=0.5, look_every_s=0.1, crowded_pause_s=0.001)
"""For what a daemon takes a few seconds over."""


def answer(request: Mapping[str, Any]) -> Mapping[str, Any]:
    if request["command"] == "refuse":
        raise InputError("mass", "-1 kg", "above 0")
    return {"echo": request}


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "run" / "yieldmon" / "s.sock"
    server = ControlServer(path, None, answer, pace=SOON)
    server.start()
    yield path
    server.stop()
    assert not path.exists()


def raw(path: Path, request: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(60.0)
        connection.connect(str(path))
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        with connection.makefile("rb") as file:
            return file.read()


def test_question_and_answer(path):
    me = pwd.getpwuid(os.getuid()).pw_name
    asked = {"command": "status", "n": 1}
    assert ask(path, asked) == {"echo": {**asked, "who": me}}
    assert ask(path, {**asked, "who": "somebody else"}) == {"echo": {**asked, "who": me}}


def test_a_refusal_is_one_line(path):
    with pytest.raises(ControlError, match=r"^mass: -1 kg; expected above 0$"):
        ask(path, {"command": "refuse"})


BAD = [
    (b"\n", "not one line of JSON"),
    (b"{", "not one line of JSON"),
    (b"\xff\xfe\n", "not one line of JSON"),
    (b"[" * 50_000 + b"\n", "not one line of JSON"),
    (b'{"command": "x", "pad": "' + b"x" * MAX_REQUEST_BYTES + b'"}\n', "not one line of JSON"),
    (b"[1, 2]\n", "names no command"),
    (b'{"command": 7}\n', "names no command"),
    (b"{}\n", "names no command"),
    (b'{"command": "status", "command": "zero"}\n', "'command' comes twice"),
    (b'{"command": "ticket", "note": {"a": 1, "b": 2, "a": 3}}\n', "'a' comes twice"),
]


@pytest.mark.parametrize(("request_line", "message"), BAD, ids=[f"{case[0][:12]!r}" for case in BAD])
def test_a_bad_request_gets_an_error_and_stops_nothing(path, request_line, message):
    try:
        reported = json.loads(raw(path, request_line))
    except (ConnectionResetError, BrokenPipeError):
        # What was sent beyond the limit was never read.
        assert len(request_line) > MAX_REQUEST_BYTES
    else:
        assert reported["ok"] is False
        assert message in reported["error"]
    assert ask(path, {"command": "status"})


def test_a_caller_that_hangs_up_stops_nothing(path):
    for _ in range(20):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(path))
    assert ask(path, {"command": "status"})


def test_only_the_daemons_user_or_its_group(tmp_path):
    path = tmp_path / "s.sock"
    server = ControlServer(path, None, answer)
    assert path.stat().st_mode & 0o777 == 0o600
    server.start()
    server.stop()
    own = grp.getgrgid(os.getgid()).gr_name
    server = ControlServer(path, own, answer)
    assert path.stat().st_mode & 0o777 == 0o660
    assert path.stat().st_gid == os.getgid()
    server.start()
    server.stop()


def test_another_user_learns_how_to_ask(path):
    """Whoever owns the socket: as somebody else, or without a right to it."""
    path.chmod(0o000)
    user = os.geteuid()
    try:
        if not user:
            os.seteuid(pwd.getpwnam("nobody").pw_uid)
        with pytest.raises(ControlError, match="Permission denied; expected sudo, or a user of the group"):
            ask(path, {"command": "status"})
    finally:
        os.seteuid(user)


def test_an_unknown_group_is_reported(tmp_path, capsys):
    path = tmp_path / "group.yaml"
    path.write_text("status: {group: no-such-group}\n")
    assert main(["check-config", str(path)]) == 0
    assert "note: status.group: this computer has no group 'no-such-group'" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"status\.group: 'no-such-group'; expected a group of this system"):
        ControlServer(tmp_path / "s.sock", "no-such-group", answer)


def test_a_file_is_no_socket_and_stays(tmp_path):
    path = tmp_path / "harvest.csv"
    path.write_text("kept")
    with pytest.raises(InputError, match=r"status\.socket: .*harvest\.csv: is a file, which is not replaced"):
        ControlServer(path, None, lambda request: {})
    assert path.read_text() == "kept"


def test_a_socket_left_by_an_earlier_run_is_replaced(tmp_path):
    path = tmp_path / "s.sock"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    server = ControlServer(path, None, answer)
    server.start()
    assert ask(path, {"command": "status"})
    server.stop()


def answers_again(path: Path) -> bool:
    try:
        return bool(ask(path, {"command": "status"}))
    except ControlError:
        return False


@pytest.mark.parametrize("folder_too", [False, True], ids=["file", "folder"])
def test_a_socket_that_is_removed_is_made_anew(path, folder_too):
    path.unlink()
    if folder_too:
        path.parent.rmdir()
    assert not answers_again(path)
    wait_for(lambda: answers_again(path), "an answer at the new socket")
    assert path.stat().st_mode & 0o777 == 0o600


def test_the_socket_of_another_daemon_at_the_same_path_is_left_alone(tmp_path):
    path = tmp_path / "s.sock"
    first, second = ControlServer(path, None, answer), None
    first.start()
    try:
        path.unlink()
        second = ControlServer(path, None, lambda request: {"second": True})
        second.start()
    finally:
        first.stop()
        assert ask(path, {"command": "status"}) == {"second": True}
        if second is not None:
            second.stop()
    assert not path.exists()


def test_the_mode_of_the_socket_is_set_whatever_the_umask(tmp_path):
    for umask in (0o000, 0o077, 0o777):
        before = os.umask(umask)
        try:
            server = ControlServer(tmp_path / "s.sock", None, answer)
        finally:
            os.umask(before)
        assert server.path.stat().st_mode & 0o777 == 0o600
        server.start()
        server.stop()


def test_peers_that_are_cut_off_while_they_speak_end_nothing(path):
    """More peers than there is room for, all of whom go on sending bytes of a request."""
    peers: list[socket.socket] = []
    try:
        for number in range(400):
            peers.append(socket.socket(socket.AF_UNIX))
            peers[-1].settimeout(60.0)
            with suppress(BlockingIOError):
                peers[-1].connect(str(path))
            for peer in peers[-60:]:
                with suppress(OSError):
                    peer.send(b"{")
            if number % 50 == 49:
                assert ask(path, {"command": "status"})["echo"]["command"] == "status"
    finally:
        for peer in peers:
            peer.close()


def test_beyond_eight_at_once_a_request_is_refused(tmp_path):
    gate, begun = threading.Event(), threading.Semaphore(0)

    def slow(request: Mapping[str, Any]) -> Mapping[str, Any]:
        if request["command"] == "wait":
            begun.release()
            gate.wait(60.0)
        return {"done": request["command"]}

    path = tmp_path / "s.sock"
    server = ControlServer(path, None, slow)
    server.start()
    answers: list[Mapping[str, Any]] = []
    askers = [threading.Thread(target=lambda: answers.append(ask(path, {"command": "wait"}, 60.0))) for _ in range(8)]
    try:
        for asker in askers:
            asker.start()
            assert begun.acquire(timeout=60.0)
        with pytest.raises(ControlError, match=r"^8 requests are being answered; nothing was done, ask again$"):
            ask(path, {"command": "status"}, 60.0)
        gate.set()
        for asker in askers:
            asker.join(60.0)
        assert answers == [{"done": "wait"}] * 8
        assert ask(path, {"command": "status"}) == {"done": "status"}
    finally:
        gate.set()
        server.stop()


def test_many_that_only_connect_keep_nobody_waiting(tmp_path, monkeypatch):
    """One connection in a look made the last of sixty wait for sixty of them."""
    rests: list[float] = []

    def rest(seconds: float) -> None:
        rests.append(seconds)
        sleep(0.02)

    monkeypatch.setattr("yieldmon.service.operator.control.sleep", rest)
    path = tmp_path / "s.sock"
    server = ControlServer(path, None, answer, pace=Pace(timeout_s=60.0, crowded_pause_s=0.25))
    server.start()
    with ExitStack() as open_peers:
        try:
            for _ in range(60):
                peer = open_peers.enter_context(socket.socket(socket.AF_UNIX))
                peer.settimeout(60.0)
                peer.connect(str(path))
            before = len(rests)
            assert ask(path, {"command": "status"}, 60.0)["echo"]["command"] == "status"
            # Eight connections in a look are eight looks for all of them.
            assert len(rests) - before <= 10
        finally:
            server.stop()


def test_half_a_request_is_refused_with_a_line(path):
    """And not merely cut off: its asker would not know whether anything was done."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(60.0)
        connection.connect(str(path))
        connection.sendall(b'{"command": "status"')
        with connection.makefile("rb") as file:
            answered = json.loads(file.read())
    assert answered == {"ok": False, "error": "request: no line feed in 0.5 s; expected one line; nothing was done"}
    assert PACE.timeout_s == 5.0, "a daemon's"


def test_out_of_descriptors_the_reason_is_one_line_and_answers_follow_later(tmp_path, caplog, monkeypatch):
    lacking = [OSError(errno.EMFILE, "Too many open files")] * 3

    class Selector(selectors.DefaultSelector):
        def __init__(self) -> None:
            if lacking:
                raise lacking.pop()
            super().__init__()

    monkeypatch.setattr(selectors, "DefaultSelector", Selector)
    path = tmp_path / "s.sock"
    server = ControlServer(path, None, answer)
    server.start()
    try:
        wait_for(lambda: answers_again(path), "an answer")
    finally:
        server.stop()
    assert [record.getMessage() for record in caplog.records if record.exc_info is None] == [
        f"{path}: Too many open files; status and commands are answered once that is over"
    ]
    assert not any(record.exc_info for record in caplog.records)


def test_what_a_daemon_of_another_version_does_not_say_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """After an update, before the service is started again."""
    path = tmp_path / "s.sock"
    before = {"number": 1, "field": "", "crop": "", "mass_kg": 280.0}
    server = ControlServer(path, None, lambda _: {"loads": [before], "units": "metric"}, pace=SOON)
    server.start()
    try:
        assert ask(path, {"command": "loads"})["loads"] == [before]
        assert main(["load", "list", "--socket", str(path)]) == 1
    finally:
        server.stop()
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("yieldmon: the daemon's answer has no '")
    assert "it runs another version" in said.err
    assert said.err.count("\n") == 1
