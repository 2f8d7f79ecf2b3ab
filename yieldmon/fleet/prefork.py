"""What the process imports that workers are forked from: all that a partition needs, compiled code included.

Python imports it by name (`multiprocessing.set_forkserver_preload`). Nothing here starts a thread, which a fork would lose:
pyarrow, whose allocator does, is left to the workers.
"""

from contextlib import suppress

from yieldmon.bus.log_files import mf4

mf4.defer()

import distributed  # noqa: E402, F401
import fsspec.implementations.local  # noqa: E402, F401

from yieldmon.bus.log_files import fast_candump  # noqa: E402
from yieldmon.fleet import worker  # noqa: E402, F401

# Where this fails each worker does it for itself.
with suppress(Exception):
    fast_candump.parse_lines(b"(1.000000) can0 18FF1080#00\n", ["can0"], lambda index, line: None, compiled=True)
