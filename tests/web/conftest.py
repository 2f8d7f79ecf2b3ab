"""A browser, a stand-in for the daemon, and the page before it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.web.browser import opened
from tests.web.standin import StandIn, page, standing_in

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with opened() as found:
        yield found


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StandIn]:
    with standing_in(tmp_path_factory.mktemp("daemon")) as found:
        found.seconds(1500)
        yield found


@pytest.fixture(scope="module")
def site(daemon: StandIn) -> Iterator[str]:
    with page(daemon.socket) as url:
        yield url
