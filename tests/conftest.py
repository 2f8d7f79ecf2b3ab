"""One thread of linear algebra per process, and a garbage collector that leaves what the collection of tests made alone."""

from __future__ import annotations

import gc
import os

# Two workers on two cores: more threads wait for each other. Read when numpy is imported, here and in the tests' processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    # The tests' modules and items stay until the end; each full collection would walk through them.
    gc.freeze()
