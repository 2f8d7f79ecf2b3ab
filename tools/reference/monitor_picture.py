"""The screen of `yieldmon monitor` as a picture, from the virtual combine with the monitor listening."""

from __future__ import annotations

import io
from pathlib import Path

WATCHED_S = 75.0


def write(target: Path) -> None:
    """Write the picture, SVG, to `target`."""
    from rich.console import Console
    from rich.terminal_theme import MONOKAI

    from yieldmon.bus.codec import Codec
    from yieldmon.engine.results import frames_in
    from yieldmon.plant import scenario
    from yieldmon.plant.combine import VirtualCombine
    from yieldmon.resources import shipped
    from yieldmon.screen.panels import Screen, View
    from yieldmon.screen.traffic import Traffic
    from yieldmon.service.assembly import build_monitor
    from yieldmon.service.config import configuration

    loaded, codec = configuration.load(shipped("config/yieldmon.yaml")), Codec()
    combine = VirtualCombine(scenario.load(shipped("config/scenarios/demo.yaml")), loaded.machine, 0)
    monitor, traffic = build_monitor(loaded.engine, loaded.machine, loaded.parameters), Traffic(codec)
    marked_s = 0.0
    for frame in combine.frames_until(WATCHED_S):
        for each in (frame, *frames_in(monitor.feed(frame))):
            message = codec.encode(each)
            message.timestamp = frame.time_s
            traffic.observe(message)
        if frame.time_s - marked_s >= 0.25:
            marked_s = frame.time_s
            traffic.mark(marked_s)
    console = Console(record=True, width=80, height=24, file=io.StringIO(), force_terminal=True, color_system="truecolor")
    console.print(Screen(traffic, View(source="socketcan can0")), height=24)
    target.write_text(console.export_svg(title="yieldmon monitor -i socketcan -c can0", theme=MONOKAI), encoding="utf-8")
