"""Mass flow over time from a store or a table of `yieldmon process`. Usage: plot_store.py STORE.sqlite PICTURE.png"""

import sys

from matplotlib.figure import Figure

from yieldmon import api

rows = api.read_seconds(sys.argv[1])
figure = Figure(figsize=(9, 3), layout="constrained")
axes = figure.subplots()
axes.plot([row.time_s - rows[0].time_s for row in rows], [row.mass_flow_kg_s or float("nan") for row in rows])
axes.set(xlabel="time, s", ylabel="mass flow, kg/s")
figure.savefig(sys.argv[2])
print(f"{len(rows)} seconds in {sys.argv[2]}")
