"""Where the page listens, and the Host and Origin headers that it answers to."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.web.addresses import host_is_ours, origin_is_ours, parse_listen
from yieldmon.web.limits import Rate, RateLimit, peer_name

LOOPBACK, LAN, ALL = (parse_listen(text) for text in ("127.0.0.1:8090", "192.168.1.5:8090", "0.0.0.0:8090"))
NAMES = frozenset({"combine", "combine.local"})


@pytest.mark.parametrize(
    ("text", "url"),
    [
        ("127.0.0.1:8090", "http://127.0.0.1:8090/"), ("[::1]:80", "http://[::1]:80/"), ("localhost:1", "http://127.0.0.1:1/"),
        ("0.0.0.0:8090", "http://127.0.0.1:8090/"), ("[::]:8090", "http://[::1]:8090/"), ("192.168.1.5:0", "http://192.168.1.5:0/"),
    ],
)  # fmt: skip
def test_addresses_are_taken(text: str, url: str) -> None:
    assert parse_listen(text).url == url


@pytest.mark.parametrize("text", ["", ":", "8090", "127.0.0.1", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:65536", "a:80", "1:²"])
def test_what_is_no_address_is_one_line(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "--listen", text, "--socket", "/nowhere"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("yieldmon: --listen: is ")
    assert said.count("\n") == 1


@pytest.mark.parametrize("text", ["0.0.0.0:0", "[::]:0", "192.168.1.5:0", "10.0.0.1:8090"])
def test_a_page_for_others_needs_a_token(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "--listen", text, "--socket", "/nowhere"]) == 2
    said = capsys.readouterr().err
    assert "--token-file" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("host", "loopback", "lan", "everywhere"),
    [
        ("127.0.0.1:8090", True, True, True), ("localhost:8090", True, True, True), ("LOCALHOST", True, True, True),
        ("[::1]:8090", True, True, True), ("192.168.1.5:8090", False, True, True), ("192.168.1.6", False, False, True),
        ("combine.local:8090", False, True, True), ("COMBINE", False, True, True), ("evil.example:8090", False, False, False),
        ("127.0.0.1.evil.example", False, False, False), ("", False, False, False),
        ("localhost.evil.example", False, False, False),
        ("evil@127.0.0.1", False, False, False), ("127.0.0.1/x", False, False, False), ("127.0.0.1:8090:1", False, False, False),
        ("[::1", False, False, False), ("2130706433", False, False, False), ("0x7f.1", False, False, False),
    ],
)  # fmt: skip
def test_only_addresses_and_own_names_are_answered(host: str, loopback: bool, lan: bool, everywhere: bool) -> None:
    assert [host_is_ours(host, listen, NAMES) for listen in (LOOPBACK, LAN, ALL)] == [loopback, lan, everywhere]


@given(st.text(max_size=40))
def test_any_host_header_is_answered_or_not(host: str) -> None:
    assert host_is_ours(host, LAN, NAMES) in (True, False)
    assert origin_is_ours(host, host) is False


@pytest.mark.parametrize(
    ("origin", "ours"),
    [
        ("http://127.0.0.1:8090", True), ("https://127.0.0.1:8090", True), ("http://127.0.0.1:8091", False), ("null", False),
        ("http://127.0.0.1", False), ("http://evil.example", False), ("file://127.0.0.1:8090", False), ("", False),
    ],
)  # fmt: skip
def test_another_port_is_another_site(origin: str, ours: bool) -> None:
    assert origin_is_ours(origin, "127.0.0.1:8090") is ours


@pytest.mark.parametrize("text", ["1.2.3.4", "not an address", "fe80::1%eth0"])
def test_everybody_has_a_name(text: str) -> None:
    assert peer_name(text)


def test_a_host_of_many_addresses_counts_as_one() -> None:
    assert peer_name("2001:db8::1") == peer_name("2001:db8::ffff:2") != peer_name("2001:db8:0:1::1")
    assert peer_name("::ffff:1.2.3.4") == "1.2.3.4"


def test_a_bucket_fills_up_again_and_no_further() -> None:
    limit = RateLimit(Rate(burst=3, per_s=0.5))
    assert [limit.take("a", 10.0) for _ in range(4)] == [0.0, 0.0, 0.0, 2.0]
    assert limit.take("b", 10.0) == 0.0
    assert limit.take("a", 12.0) == 0.0
    assert [limit.take("a", 1000.0) == 0.0 for _ in range(4)] == [True, True, True, False]


def test_many_names_take_bounded_memory() -> None:
    limit = RateLimit(Rate(burst=1, per_s=0.001), names=10)
    assert limit.take("first", 0.0) == 0.0
    assert limit.take("first", 0.0) > 0.0
    for number in range(10):
        limit.take(str(number), 0.0)
    assert limit.take("first", 0.0) == 0.0


def test_a_bad_listen_names_what_was_expected() -> None:
    with pytest.raises(InputError, match=r"ADDRESS:PORT"):
        parse_listen("x")
