"""What the page refuses, and what it says of itself in each answer."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.web.standin import StandIn, standing_in

pytest.importorskip("starlette")
from starlette.testclient import TestClient

from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.service.storage.batch import FaultEvent
from yieldmon.web.addresses import parse_listen
from yieldmon.web.app import MOST_BODY_BYTES, STATIC, Sources, build_app
from yieldmon.web.guard import COMMANDS, HEADERS, REQUESTS, WRONG_TOKENS, Access
from yieldmon.web.tiles import Tiles
from yieldmon.web.tokens import COOKIE_LIFE_S, cookie, cookie_is_good, read_token

SITE = "http://127.0.0.1:8090"
TOKEN = "correct-horse-battery"
PATHS = ("/", "/history", "/sign-in", "/static/live.js", "/api/page", "/api/history", "/api/points", "/nowhere")


class Clock:
    """A clock that stands still."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="module")
def one_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    with standing_in(tmp_path_factory.mktemp("daemon")) as found:
        found.seconds(30)
        yield found


@pytest.fixture
def daemon(one_daemon: StandIn) -> StandIn:
    one_daemon.asked.clear()
    one_daemon.refuses = ""
    return one_daemon


def client(daemon: StandIn, clock: Clock, token: str | None = None, *, read_only: bool = False) -> TestClient:
    """Somebody who asks, from the page's own site."""
    access = Access(parse_listen("127.0.0.1:8090"), token, read_only)
    app = build_app(access, Sources(daemon.socket), clock=clock, unix_clock=lambda: 1e9 + clock.now_s)
    return TestClient(app, base_url=SITE, headers={"origin": SITE}, follow_redirects=False)


def test_every_answer_has_the_headers(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock)
    answers = [asking.get(path) for path in PATHS]
    answers += [asking.get("/", headers={"host": "evil.example"}), asking.put("/"), asking.post("/api/command", json={})]
    assert {answer.status_code for answer in answers} == {200, 404, 405, 409, 421}
    for answer in answers:
        assert {name: answer.headers[name] for name in HEADERS} == dict(HEADERS)
        assert "server" not in answer.headers


def test_the_policy_lets_nothing_of_another_origin_in() -> None:
    policy = dict(part.strip().split(" ", 1) for part in HEADERS["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert {policy[name] for name in ("script-src", "style-src", "img-src", "connect-src")} == {"'self'"}
    assert {policy[name] for name in ("base-uri", "form-action", "frame-ancestors")} == {"'none'"}


def test_no_file_names_another_machine() -> None:
    ours = [path for path in STATIC.rglob("*") if path.suffix in (".html", ".css", ".js") and "vendor" not in path.parts]
    assert len(ours) > 8
    for path in ours:
        text = path.read_text()
        assert "//" not in text.replace("// ", "").replace("http://www.w3.org/2000/svg", ""), path
        assert "style=" not in text, path
        assert "innerHTML" not in text, path
        assert "onclick" not in text, path


@pytest.mark.parametrize("path", PATHS)
def test_dns_rebinding_is_refused(daemon: StandIn, clock: Clock, path: str) -> None:
    asking = client(daemon, clock)
    for host in ("evil.example", "evil.example:8090", "127.0.0.1.nip.io", "192.168.1.5", ""):
        assert asking.get(path, headers={"host": host}).status_code == 421
    two = [(b"host", b"127.0.0.1:8090"), (b"host", b"evil.example")]
    assert asking.get(path, headers=two).status_code == 421


@pytest.mark.parametrize(("units", "said"), [("metric", "measured 1840 kg"), ("us", "measured 4,057 lb")])
def test_what_the_daemon_says_is_in_its_units(tmp_path: Path, clock: Clock, units: str, said: str) -> None:
    """A fault's masses came in kilograms to a page in pounds, and a refusal's."""
    with standing_in(tmp_path, units=units) as daemon:
        daemon.seconds(3)
        fault = FaultEvent(daemon.start_s, "ScaleDisagrees", active=True, detail="scale: measured 1840 kg")
        daemon.commit(faults=(fault,))
        asking = client(daemon, clock)
        assert asking.get("/api/history").json()["faults"][0]["detail"] == f"scale: {said}"
        daemon.refuses = "the load measured 1840 kg"
        refusal = asking.post("/api/command", json={"command": "sweep-start"})
        assert (refusal.status_code, refusal.json()["error"]) == (409, f"sweep-start: the load {said}")


def test_a_refusal_names_the_pages_buttons(daemon: StandIn, clock: Clock) -> None:
    daemon.refuses = "no load is open; expected one that `yieldmon load start` began"
    refusal = client(daemon, clock).post("/api/command", json={"command": "sweep-start"})
    assert refusal.json()["error"] == "sweep-start: no load is open; expected one that New load began"
    daemon.refuses = "there is grain; expected the elevator running empty; `yieldmon zero --force` if it does"
    refusal = client(daemon, clock).post("/api/command", json={"command": "zero"})
    assert refusal.json()["error"].endswith("; `yieldmon zero --force` on the monitor's computer if it does")


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"origin": "http://evil.example"}, 403), ({"origin": "null"}, 403), ({"origin": "http://127.0.0.1:9999"}, 403),
        ({"origin": "http://localhost:8090"}, 403), ({"origin": SITE}, 200),
    ],
)  # fmt: skip
def test_commands_come_from_the_page_itself(daemon: StandIn, clock: Clock, headers: dict[str, str], status: int) -> None:
    answer = client(daemon, clock).post("/api/command", json={"command": "sweep-start"}, headers=headers)
    assert answer.status_code == status
    assert len(daemon.asked) == (status == 200)


def test_a_command_without_an_origin_shows_who_it_is(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, TOKEN)
    del asking.headers["origin"]
    request = {"command": "sweep-start"}
    assert asking.post("/api/command", json=request).status_code == 403
    asking.cookies.set("yieldmon", cookie(TOKEN, 1e9))
    assert asking.post("/api/command", json=request).status_code == 403
    assert asking.post("/api/command", json=request, headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_other_sites_may_link_to_the_page_and_nothing_else(daemon: StandIn, clock: Clock, site: str) -> None:
    asking = client(daemon, clock)
    fetched = {"sec-fetch-site": site, "sec-fetch-mode": "no-cors", "sec-fetch-dest": "image"}
    assert {asking.get(path, headers=fetched).status_code for path in PATHS} == {403}
    framed = {"sec-fetch-site": site, "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"}
    assert asking.get("/", headers=framed).status_code == 403
    opened = {"sec-fetch-site": site, "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}
    assert asking.get("/", headers=opened).status_code == 200


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""])
def test_what_a_form_can_send_is_no_command(daemon: StandIn, clock: Clock, kind: str) -> None:
    body = json.dumps({"command": "sweep-start"})
    assert client(daemon, clock).post("/api/command", content=body, headers={"content-type": kind}).status_code == 409
    assert not daemon.asked


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"[]", b"null", b'"status"', b'{"command": 1}', b'{"command": "status"}',
        b'{"command": "totals-reset", "total_kg": 1}',
        b'{"command": "zero", "force": true}', b'{"command": "load-start", "shown_load": 1, "thousand_kernel_weight_g": 3}',
        b"[" * 4000, b" " * (MOST_BODY_BYTES + 1), b'{"command": "load-stop"}',
        b'{"command": "load-stop", "shown_load": 2}', b"\xff\xfe",
    ],
)  # fmt: skip
def test_what_a_page_may_not_ask_never_reaches_the_daemon(daemon: StandIn, clock: Clock, body: bytes) -> None:
    answer = client(daemon, clock).post("/api/command", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 409
    assert answer.json()["error"]
    assert not daemon.asked


def test_commands_reach_the_daemon_and_its_refusals_come_back(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock)
    requests = [
        {"command": "load-start", "field": "<b>north</b>", "crop": "corn"}, {"command": "load-stop"},
        {"command": "ticket", "first_load": 1, "last_load": 1, "mass_kg": 200.0, "note": "n"},
    ]  # fmt: skip
    for request in requests:
        assert asking.post("/api/command", json={**request, "shown_load": 1}).status_code == 200
    assert daemon.asked == requests
    daemon.refuses = "there is grain"
    answer = asking.post("/api/command", json={"command": "zero"})
    assert (answer.status_code, answer.json()) == (409, {"error": "zero: there is grain"})


@pytest.mark.parametrize(("command", "button"), [("load-start", "New load"), ("load-stop", "End load")])
def test_a_button_pressed_on_an_old_screen_is_told_which_load_it_is(
    daemon: StandIn, clock: Clock, command: str, button: str
) -> None:
    answer = client(daemon, clock).post("/api/command", json={"command": command, "shown_load": 0})
    said = f"{button}: the load in the tank is now 1; expected Cancel, a look at that load, and then the button again"
    assert (answer.status_code, answer.json()["error"]) == (409, said)
    assert daemon.asked == []


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("since=abc", "'since': is not known here; expected day or load"),
        ("load=abc", "load: 'abc'; expected the number of a load"),
        ("load=-1", "load: '-1'; expected the number of a load"),
        ("day=yesterday", "day: 'yesterday'; expected today or a day such as 2025-10-09"),
        ("day=2025-10-9", "day: '2025-10-9'; expected today or a day such as 2025-10-09"),
    ],
)
def test_points_of_what_cannot_be_are_refused(daemon: StandIn, clock: Clock, query: str, said: str) -> None:
    answer = client(daemon, clock).get(f"/api/points?{query}")
    assert (answer.status_code, answer.json()["error"]) == (400, said)


@pytest.mark.parametrize("query", ["", "day=today", "day=2025-10-09", "load=1", "day=&load="])
def test_points_of_a_day_or_a_load_are_given(daemon: StandIn, clock: Clock, query: str) -> None:
    assert client(daemon, clock).get(f"/api/points?{query}").status_code == 200


def test_a_daemon_of_another_version_is_commanded_nothing(daemon: StandIn, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = daemon.status
    monkeypatch.setattr(daemon, "status", lambda: {name: part for name, part in whole().items() if name not in ("load", "crop")})
    answer = client(daemon, clock).post("/api/command", json={"command": "sweep-start"})
    assert answer.status_code == 409
    assert "runs another version" in answer.json()["error"]
    assert not daemon.asked


def test_a_store_of_few_sweeps_has_no_residuals_and_a_note(daemon: StandIn, clock: Clock) -> None:
    answer = client(daemon, clock).get("/api/residuals")
    assert answer.status_code == 200
    assert answer.json()["cells"] == []
    assert "holds no parameters" in answer.json()["note"]


def test_a_read_only_page_commands_nothing(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, read_only=True)
    assert asking.get("/api/page").json()["read_only"] is True
    assert asking.post("/api/command", json={"command": "sweep-start"}).status_code == 403
    assert not daemon.asked


def test_commands_are_for_thumbs(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock)
    codes = [asking.post("/api/command", json={"command": "sweep-start"}).status_code for _ in range(20)]
    assert codes.count(200) == len(daemon.asked) == COMMANDS.burst
    assert set(codes) == {200, 429}
    clock.now_s += 1 / COMMANDS.per_s
    assert asking.post("/api/command", json={"command": "sweep-start"}).status_code == 200


def test_too_many_requests_are_refused_for_a_while(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock)
    codes = [asking.get("/api/page").status_code for _ in range(int(REQUESTS.burst) + 5)]
    assert codes.count(200) == REQUESTS.burst
    refused = asking.get("/api/page")
    assert refused.status_code == 429
    clock.now_s += float(refused.headers["retry-after"])
    assert asking.get("/api/page").status_code == 200


def test_without_the_token_there_is_a_door_and_no_more(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, TOKEN)
    codes = {path: asking.get(path).status_code for path in (*PATHS, "/api/live", "/api/residuals", "/tiles/1/1/1")}
    assert {path for path, code in codes.items() if code == 200} == {"/sign-in", "/static/live.js"}
    assert set(codes.values()) == {200, 303, 401}
    assert asking.get("/").headers["location"] == "/sign-in"
    assert asking.post("/api/command", json={"command": "sweep-start"}).status_code == 401
    assert not daemon.asked


def test_the_token_opens_the_page_by_cookie(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, TOKEN)
    answer = asking.post("/sign-in", json={"token": TOKEN})
    assert answer.status_code == 204
    said = answer.headers["set-cookie"].lower()
    assert "httponly" in said
    assert "samesite=strict" in said
    assert TOKEN not in said
    assert asking.get("/api/page").status_code == 200
    clock.now_s += COOKIE_LIFE_S + 1
    assert asking.get("/api/page").status_code == 401


def test_a_cookie_outlives_a_restart_but_not_another_token(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, TOKEN)
    asking.post("/sign-in", json={"token": TOKEN})
    for token, status in ((TOKEN, 200), ("another-token-another", 401)):
        after = client(daemon, clock, token)
        after.cookies.update(asking.cookies)
        assert after.get("/api/page").status_code == status


@pytest.mark.parametrize(
    "value", ["", ".", "9999999999.", "9999999999.00", "9" * 40 + ".00", "x.y", "٣.y", f"9999999999.{'0' * 64}", "1.2.3"]
)
def test_made_up_cookies_open_nothing(value: str) -> None:
    assert cookie_is_good(value, TOKEN, 1e9) is False


@pytest.mark.parametrize("shown", ["sign-in", "bearer"])
def test_guessing_comes_to_an_end(daemon: StandIn, clock: Clock, shown: str) -> None:
    asking = client(daemon, clock, TOKEN)

    def show(token: str) -> int:
        if shown == "sign-in":
            return asking.post("/sign-in", json={"token": token}).status_code
        return asking.get("/api/page", headers={"authorization": f"Bearer {token}"}).status_code

    codes = [show(f"guess-{number}") for number in range(30)]
    assert codes.count(401) == WRONG_TOKENS.burst
    assert set(codes) == {401, 429}
    # Not even the right one, so that a guess tells nothing; those who are signed in go on.
    assert show(TOKEN) == 429
    signed_in = client(daemon, clock, TOKEN)
    asking.cookies.set("yieldmon", cookie(TOKEN, 1e9))
    assert asking.get("/api/page").status_code == 200
    asking.cookies.clear()
    clock.now_s += 1 / WRONG_TOKENS.per_s
    assert show(TOKEN) in (200, 204)
    signed_in.close()


@pytest.mark.parametrize(
    ("content", "mode", "problem"),
    [
        (b"short", 0o600, "holds no token"), (b"", 0o600, "holds no token"),
        (b"two words of a long token", 0o600, "holds no token"),
        (b"\xff" * 40, 0o600, "holds no token"), (b"a" * 5000, 0o600, "holds no token"),
        (TOKEN.encode(), 0o604, "everybody"), (None, 0, "No such file"),
    ],
)  # fmt: skip
def test_a_token_file_that_is_none_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, mode: int, problem: str
) -> None:
    path = tmp_path / "token"
    if content is not None:
        path.write_bytes(content)
        path.chmod(mode)
    assert main(["web", "--token-file", str(path), "--listen", "0.0.0.0:0", "--socket", "/nowhere"]) == 2
    said = capsys.readouterr().err
    assert problem in said
    assert said.count("\n") == 1


def test_a_token_file_may_end_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n")
    path.chmod(0o600)
    assert read_token(path) == TOKEN


@pytest.mark.parametrize("path", ["/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py", "/static//etc/passwd"])
def test_only_shipped_files_are_given(daemon: StandIn, clock: Clock, path: str) -> None:
    assert client(daemon, clock).get(path).status_code == 404


@pytest.mark.parametrize("origin", ["http://[::1", "http://[x]:1", "//", "http://127.0.0.1:99999999"])
def test_an_origin_that_is_none_is_another_site(daemon: StandIn, clock: Clock, origin: str) -> None:
    answer = client(daemon, clock).post("/api/command", json={"command": "sweep-start"}, headers={"origin": origin})
    assert answer.status_code == 403
    assert not daemon.asked


def test_a_token_that_is_no_text_is_a_wrong_one(daemon: StandIn, clock: Clock) -> None:
    asking = client(daemon, clock, TOKEN)
    sent = {"content": rb'{"token": "\ud800"}', "headers": {"content-type": "application/json"}}
    codes = [asking.post("/sign-in", **sent).status_code for _ in range(7)]
    assert codes == [401] * int(WRONG_TOKENS.burst) + [429] * 2


@pytest.mark.parametrize("place", ["1/1/" + "9" * 5000, "9" * 5000 + "/1/1", "1/-1/1", "1/x/1", "1/\u0661/1"])
def test_a_tile_of_no_number_is_not_there(daemon: StandIn, clock: Clock, place: str) -> None:
    assert client(daemon, clock).get(f"/tiles/{place}").status_code == 404


def tiles_of(path: Path, *statements: str) -> Path:
    with closing(sqlite3.connect(path)) as database:
        for statement in ("CREATE TABLE metadata (name TEXT, value TEXT)", *statements):
            database.execute(statement)
        database.commit()
    return path


def test_a_view_of_tiles_that_never_ends_costs_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """zoom 1 is there at once, any other is searched for ever."""
    monkeypatch.setattr("yieldmon.web.tiles._LOOK_S", 0.05)
    monkeypatch.setattr("yieldmon.web.tiles._FIRST_LOOK_S", 0.05)
    endless = (
        "CREATE VIEW tiles AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) "
        "SELECT 1 AS zoom_level, n AS tile_column, 1 AS tile_row, x'89504e47' AS tile_data FROM r"
    )
    with pytest.raises(InputError, match="interrupted"):
        Tiles(tiles_of(tmp_path / "a.mbtiles", endless))
    table = "CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)"
    path = tiles_of(tmp_path / "b.mbtiles", table, "INSERT INTO tiles VALUES (1, 0, 1, x'89504e47')")
    tiles = Tiles(path)
    assert tiles.tile(1, 0, 0) == (b"\x89PNG", "image/png")
    tiles_of(path.with_name("c.mbtiles"), endless).replace(path)
    assert tiles.tile(1, -1, 0) is None


def test_without_a_daemon_the_page_says_so(tmp_path: Path, clock: Clock) -> None:
    absent = StandIn(tmp_path)
    answer = client(absent, clock).get("/api/history")
    assert answer.status_code == 503
    assert "no daemon answers" in answer.json()["error"]
    assert client(absent, clock).post("/api/command", json={"command": "zero"}).status_code == 409
