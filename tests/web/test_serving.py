"""The server as a process of its own, and peers that mean it no good."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests import forked
from tests.service.bench import wait_for
from tests.web.standin import StandIn, page, standing_in

pytest.importorskip("uvicorn")
from yieldmon.cli.main import main
from yieldmon.web.protocol import CONNECTIONS, TIMEOUT_S, BoundedProtocol

PATIENT_S = 3 * TIMEOUT_S


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    with standing_in(tmp_path_factory.mktemp("daemon")) as found:
        found.seconds(30)
        yield found


@contextmanager
def served(daemon: StandIn, before: str = "") -> Iterator[tuple[str, int]]:
    with page(daemon.socket, before=before) as url:
        parts = urlsplit(url)
        assert parts.hostname is not None
        assert parts.port is not None
        yield parts.hostname, parts.port


@pytest.fixture(scope="module")
def address(daemon: StandIn) -> Iterator[tuple[str, int]]:
    with served(daemon) as found:
        yield found


#: The same with a second's patience for a request and for the taking of an answer.
IMPATIENT = """
from yieldmon.web import protocol, serving
protocol.BoundedProtocol.timeout_s = serving.TIMEOUT_S = 1.0
"""


@pytest.fixture(scope="module")
def impatient(daemon: StandIn) -> Iterator[tuple[str, int]]:
    with served(daemon, IMPATIENT) as found:
        yield found


def test_a_peer_has_five_seconds() -> None:
    assert TIMEOUT_S == BoundedProtocol.timeout_s == 5.0


def status(address: tuple[str, int], path: str = "/api/page", **headers: str) -> int:
    connection = http.client.HTTPConnection(*address, timeout=PATIENT_S)
    try:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def answered(address: tuple[str, int]) -> bool:
    """Whether a page is answered; on a busy machine one may be cut off for being slow itself."""
    with suppress(OSError, http.client.HTTPException):
        return status(address) == 200
    return False


#: As under the unit, which lets a process send no signal, not even to itself.
NO_SIGNALS = """
import signal
def refused(*_): raise PermissionError(1, "Operation not permitted")
signal.raise_signal = refused
signal.signal(signal.SIGINT, signal.default_int_handler)
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_process_that_may_send_no_signal_ends_by_one(daemon: StandIn, number: int, code: int) -> None:
    words = ["web", "--socket", str(daemon.socket), "--listen", "127.0.0.1:0"]
    with forked.running(*words, before=NO_SIGNALS) as process:
        assert "http://" in process.line()
        process.send_signal(number)
        assert (process.rest(), process.wait()) == ("", code)


def ends(connection: socket.socket) -> bool:
    """Whether the server ends the connection by itself."""
    connection.settimeout(PATIENT_S)
    try:
        while connection.recv(65536):
            pass
    except TimeoutError:
        return False
    except OSError:
        return True
    return True


BEGUN = (
    b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n",
    b"POST /api/command HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99\r\n\r\n{",
    b"GET /static/page.css HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET",
)  # fmt: skip


def test_half_a_request_is_not_waited_for(impatient: tuple[str, int]) -> None:
    with ExitStack() as stack:
        connections = [stack.enter_context(socket.create_connection(impatient)) for _ in BEGUN]
        for connection, begun in zip(connections, BEGUN, strict=True):
            connection.sendall(begun)
        assert [ends(connection) for connection in connections] == [True] * len(BEGUN)


def test_200_silent_connections_leave_room_for_others(address: tuple[str, int]) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(socket.create_connection(address)) for _ in range(200)]
        assert status(address) == 200
        still = 0
        for connection in silent:
            connection.settimeout(0.0)
            try:
                still += connection.recv(1) != b""
            except BlockingIOError:
                still += 1
            except OSError:
                pass
        assert still <= CONNECTIONS


def test_200_live_pages_are_bounded_and_others_are_answered(address: tuple[str, int]) -> None:
    with ExitStack() as stack:
        codes = []
        for _ in range(40):
            connection = http.client.HTTPConnection(*address, timeout=PATIENT_S)
            stack.callback(connection.close)
            connection.request("GET", "/api/live")
            codes.append(connection.getresponse().status)
        assert set(codes) <= {200, 503, 429}
        assert codes.count(200) <= 24
        assert status(address, "/static/page.css") == 200


def test_a_page_that_takes_nothing_is_cut_off(impatient: tuple[str, int]) -> None:
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(impatient)
        # Far more answers than the sockets' buffers hold, and nobody who reads them.
        request = b"GET /static/vendor/uPlot.iife.min.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        connection.settimeout(PATIENT_S)
        end_s = time.monotonic() + PATIENT_S
        cut = False
        while not cut and time.monotonic() < end_s:
            try:
                connection.sendall(request * 100)
            except TimeoutError:
                break
            except OSError:
                cut = True
        assert cut or ends(connection)
    wait_for(lambda: answered(impatient), "an answer to another page")


@pytest.mark.parametrize(
    "nonsense",
    [
        b"\x16\x03\x01\x02\x00", b"GET / HTTP/9.9\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", b"\0" * 50_000,
    ],
    ids=["TLS", "version", "no host", "two hosts", "long", "zeros"],
)  # fmt: skip
def test_nonsense_is_refused(address: tuple[str, int], nonsense: bytes) -> None:
    with socket.create_connection(address) as connection:
        connection.settimeout(PATIENT_S)
        try:
            connection.sendall(nonsense)
            received = connection.recv(100)
        except ConnectionError:
            received = b""
        assert received[:10] in (b"", b"HTTP/1.1 4")
    assert status(address) == 200


def test_a_name_of_somebody_elses_is_refused(address: tuple[str, int]) -> None:
    assert status(address, "/", Host="evil.example") == 421


def test_a_live_page_ends_with_the_server(daemon: StandIn) -> None:
    with ExitStack() as stack:
        with page(daemon.socket) as url:
            connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=PATIENT_S)
            stack.callback(connection.close)
            connection.request("GET", "/api/live")
            answer = connection.getresponse()
            lines = [answer.readline() for _ in range(3)]
            assert json.loads(lines[2].removeprefix(b"data: "))["state"] == "harvesting"
        answer.read()


def test_an_address_in_use_is_one_line(address: tuple[str, int], capsys: pytest.CaptureFixture[str]) -> None:
    host, port = address
    assert main(["web", "--listen", f"{host}:{port}", "--socket", "/nowhere"]) == 1
    assert capsys.readouterr().err == f"yieldmon: {host}:{port}: Address already in use\n"


@pytest.mark.parametrize(
    ("options", "problem"), [(["--store", "none.sqlite"], "no such file"), (["--tiles", "none.mbtiles"], "no such file")]
)
def test_a_missing_file_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str], problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["web", "--socket", "/nowhere", *options]) == 2
    said = capsys.readouterr().err
    assert problem in said
    assert said.count("\n") == 1
