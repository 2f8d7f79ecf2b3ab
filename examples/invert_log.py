"""A CAN log through the monitor, second by second. Usage: invert_log.py LOG; any format of python-can, also gzipped."""

import sys

from yieldmon import api

loaded = api.load_configuration(api.shipped("config/yieldmon.yaml"))
monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters, drives_plate=False)
rows: list[api.SecondRow] = []
summary = api.process_logs([sys.argv[1]], monitor, api.Codec(), rows.append)
flows = [row.mass_flow_kg_s for row in rows if row.mass_flow_kg_s is not None]
print(f"{summary.frames} frames, {summary.windows} seconds, {len(flows)} with a flow, {sum(flows):.1f} kg")
for damage in summary.damages:
    print(f"skipped: {damage}")
