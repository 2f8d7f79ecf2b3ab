"""What the sampling rate of an impact sensor costs, at three elevator speeds.

    python -m studies.sample_rates [--seconds S] [--flow KG_S] [--seed N] [--json]

The virtual combine at a steady flow; one sample of so many is kept, as a slow sensor without a filter takes them, and goes
through the engine with the rate stated in its sources. Figures: standard deviation of the one-second flows over their mean, what
the engine states for it, and the error of the mass.
"""

from __future__ import annotations

import argparse
import dataclasses
import json

import numpy as np

from yieldmon import frames as bus
from yieldmon.engine.flow_filter import FlowFilterSettings
from yieldmon.engine.results import records_in
from yieldmon.engine.sources import DEFAULT_SOURCES, SampleSource, Sources
from yieldmon.files import machine_file, parameter_file
from yieldmon.frames import Frame
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.document import Document
from yieldmon.service.config.engine_sections import engine_settings

RATES_HZ = (10, 20, 50, 100, 200, 500, 1000)
SPEEDS_RPM = (300.0, 400.0, 500.0)
EMPTY_S, SKIPPED_S = 14, 22
MESSAGE = "Slow"


def harvest(rpm: float, seconds: int, flow_kg_s: float, seed: int) -> tuple[list[Frame], float]:
    """The combine's frames, and the mass that passed after the seconds that are skipped."""
    pieces = [
        {"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0.0},
        {"kind": "steady", "duration_s": 10_000, "flow_kg_s": flow_kg_s},
    ]
    document = {"duration_s": float(seconds), "flow": {"pieces": pieces}, "elevator": {"speed_rpm": rpm}}
    combine = VirtualCombine(scenario.from_mapping(document, "sample-rates"), machine_file.load(None), seed)
    return list(combine.frames_until(float(seconds))), flow_kg_s * (seconds - 1 - SKIPPED_S)


def thinned(frames: list[Frame], rate_hz: int) -> list[Frame]:
    """One sample of so many, each a frame of its own at its own time."""
    every, count = 1000 // rate_hz, 0
    out: list[Frame] = []
    for frame in frames:
        if frame.message != bus.IMPACT_SENSOR_SAMPLES:
            out.append(frame)
            continue
        for place in range(bus.SAMPLES_PER_FRAME):
            count += 1
            if count % every == 0:
                at_s = frame.time_s - bus.SAMPLE_INTERVAL_S * (bus.SAMPLES_PER_FRAME - 1 - place)
                out.append(Frame(at_s, MESSAGE, {"Sample": frame.signals[f"Sample{place}"]}))
    return sorted(out, key=lambda each: each.time_s)


def measured(frames: list[Frame], rate_hz: int, mass_kg: float) -> dict[str, float]:
    """Figures of one rate, %."""
    settings = dataclasses.replace(engine_settings(Document()), flow_filter=FlowFilterSettings(enabled=False))
    settings = dataclasses.replace(settings, sweep=dataclasses.replace(settings.sweep, enabled=False))
    sources = Sources((SampleSource(MESSAGE, ("Sample",), 1.0 / rate_hz),), DEFAULT_SOURCES.inputs)
    monitor = build_monitor(settings, machine_file.load(None), parameter_file.load(), None, sources)
    records = [record for frame in thinned(frames, rate_hz) for record in records_in(monitor.feed(frame))][SKIPPED_S:]
    flows = np.array([record.mass_flow_kg_s for record in records])
    stated = np.array([record.std_dev_kg_s for record in records])
    return {
        "scatter_pct": float(100.0 * np.nanstd(flows) / np.nanmean(flows)),
        "stated_pct": float(100.0 * np.nanmean(stated) / np.nanmean(flows)),
        "mass_error_pct": float(100.0 * (sum(record.mass_kg for record in records) / mass_kg - 1.0)),
        "windows": len(records),
        "without_flow": int(np.isnan(flows).sum()),
    }


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m studies.sample_rates", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=90, help="of harvest at each speed, the empty elevator included")
    parser.add_argument("--flow", type=float, default=12.0, metavar="KG_S")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, dict[str, dict[str, float]]] = {}
    for rpm in SPEEDS_RPM:
        frames, mass_kg = harvest(rpm, options.seconds, options.flow, options.seed)
        found[f"{rpm:g}"] = {str(rate): measured(frames, rate, mass_kg) for rate in RATES_HZ}
    if options.json:
        print(json.dumps(found, indent=2))
        return 0
    print("scatter of one-second flows / stated standard deviation / error of the mass, %")
    print(f"{'Hz':>6}" + "".join(f"{rpm + ' rpm':>26}" for rpm in found))
    for rate in RATES_HZ:
        cells = (found[rpm][str(rate)] for rpm in found)
        row = (f"{c['scatter_pct']:8.1f} /{c['stated_pct']:6.1f} /{c['mass_error_pct']:+6.1f}" for c in cells)
        print(f"{rate:>6}" + "".join(f"{cell:>26}" for cell in row))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
