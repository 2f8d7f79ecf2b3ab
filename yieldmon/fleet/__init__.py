"""Logs of many machines and days on a distributed engine, and what a fleet knows that one machine cannot (the fleet extra).

`manifest` says what there is, `identity` by which hashes a result is known, `measuring` makes one partition's tables, `dataset`
keeps partitions whole, `worker` is the task, `scheduling` hands tasks to Dask; `summary`, `html` and `comparison` read datasets.
"""
