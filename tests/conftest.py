"""One thread of linear algebra per process, asammdf imported only where it is used, property tests with fixed examples, a
garbage collector that leaves alone what the collection of tests made, and logging as it was before each test."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Iterator

import pytest

from yieldmon.bus.log_files import mf4

# As every command does: python-can would import asammdf, and with it pandas and sympy, in each worker.
mf4.defer()

# Two workers on two cores: more threads wait for each other. Read when numpy is imported, here and in the tests' processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# While modules are imported and tests are made nearly everything stays.
gc.disable()


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Property tests take the same examples in each run; new ones: --hypothesis-profile random."""
    if not config.pluginmanager.has_plugin("hypothesispytest"):
        return  # the virtual machine's tests do without it
    from hypothesis import HealthCheck, settings

    # How long an example takes says more of the machine's other work than of the code.
    untimed = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True)
    settings.register_profile("fixed", untimed, derandomize=True)
    settings.register_profile("random", untimed, derandomize=False)
    settings.load_profile("fixed")


def pytest_collection_finish() -> None:
    # The tests' modules and items stay until the end; each full collection would walk through them. Messages and rows are made by
    # the ten thousand and seldom in cycles: looked through less often than by default (700, 10, 10).
    gc.set_threshold(20_000, 20, 20)
    gc.enable()
    gc.freeze()


@pytest.fixture(autouse=True)
def logging_as_before() -> Iterator[None]:
    """A command that runs in the tests' own process filters what pytest's handlers take, and sets levels."""
    ours, handlers = logging.getLogger("yieldmon"), logging.getLogger().handlers
    level, before = ours.level, {handler: list(handler.filters) for handler in handlers}
    yield
    ours.setLevel(level)
    for handler, filters in before.items():
        handler.filters[:] = filters
