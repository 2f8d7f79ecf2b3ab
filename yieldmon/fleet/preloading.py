"""What a Dask worker does first (`distributed.worker.preload`): it holds back what a partition does not need.

python-can imports asammdf where that is installed, and with it pandas and sympy: half of what a worker's start takes.
"""

from yieldmon.bus.log_files import mf4

mf4.defer()
