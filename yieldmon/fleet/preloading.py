"""What a Dask worker does first (`distributed.worker.preload`): it holds back what a partition does not need, and is quiet.

python-can imports asammdf where that is installed, and with it pandas and sympy: half of what a worker's start takes.
"""

import logging

from yieldmon.bus.log_files import mf4

mf4.defer()
# A worker that is stopped may be asking the scheduler; Dask has a level of its own for this one.
logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
