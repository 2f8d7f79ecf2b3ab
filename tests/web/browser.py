"""Debian's chromium, driven by playwright."""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CAB, OFFICE = {"width": 1024, "height": 600}, {"width": 1920, "height": 1080}
READY = "!document.getElementById('buttons').hidden && document.getElementById('load-name').textContent !== 'Load'"
"""The live page has its buttons and a load."""
ASKED = "!document.querySelector('dialog[open]') || document.querySelector('dialog[open] .problem').textContent !== ''"
"""A dialog is closed, or says what is wrong."""


def chromium() -> str | None:
    """The browser's path, None where there is none."""
    return next((path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None)


@contextmanager
def opened() -> Iterator[Browser]:
    """The browser, without windows."""
    from playwright.sync_api import sync_playwright

    # Chromium's own sandbox does not run for root.
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    arguments += ["--enable-precise-memory-info", "--js-flags=--expose-gc", "--disable-background-networking"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=arguments)
        try:
            yield browser
        finally:
            browser.close()


ANSWER_S = 60.0
"""A page may take for an expression."""


class Watched:
    """A page, and what it asked for and complained of."""

    def __init__(self, browser: Browser, size: dict[str, int] = CAB, **context: Any) -> None:
        self.context = browser.new_context(viewport=size, locale="en-GB", timezone_id="UTC", **context)
        self.page: Page = self.context.new_page()
        self.asked: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))

    def wait(self, condition: str, timeout_s: float = 60.0) -> None:
        """Until an expression holds; playwright's own waiting evaluates text, which the page's policy forbids."""
        end_s, rest_ms = time.monotonic() + timeout_s, 25.0
        while not self._holds(condition):
            assert time.monotonic() < end_s, f"still waiting for {condition}; {self.complaints}"
            self.page.wait_for_timeout(rest_ms)
            rest_ms = min(1.3 * rest_ms, 200.0)

    def evaluate(self, expression: str, timeout_s: float = ANSWER_S) -> Any:
        """What a JavaScript expression gives, which has to be of JSON's kinds. playwright's own waits without end for a page that
        hangs. Raises TimeoutError."""
        # Its public calls take no limit.
        answer = self.page._impl_obj.evaluate(expression, None)  # noqa: SLF001
        try:
            return self.page._sync(asyncio.wait_for(answer, timeout_s))  # noqa: SLF001
        except TimeoutError as error:
            raise TimeoutError(f"no answer in {timeout_s:g} s to {expression}; {self.complaints}") from error

    def _holds(self, condition: str) -> bool:
        from playwright.sync_api import Error

        try:
            return bool(self.evaluate(condition))
        except Error as error:
            # Asked on the way from one page to the next.
            if "context was destroyed" in str(error):
                return False
            raise

    def __enter__(self) -> Watched:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.close()
