"""The page's own unit, begun again and again: each start shows what the daemon measures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from combine_service import grows, harvest, service, write_log
from page_client import asked, live_rows, page_listens
from service_manager import WEB_UNIT, eventually, run

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

STARTS = 20


@pytest.fixture(scope="module", autouse=True)
def measuring(daemon_command: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Daemon and page, and a combine that harvests."""
    log = write_log(tmp_path_factory.mktemp("traffic") / "combine.log")
    with service(daemon_command, page=True), harvest(log):
        grows()
        eventually(page_listens, "the page")
        yield


def test_each_start_of_the_page_shows_seconds_and_history() -> None:
    for _ in range(STARTS):
        run("systemctl", "restart", WEB_UNIT)
        eventually(page_listens, "the page")
        assert live_rows()
        assert asked("/api/history")["days"]
