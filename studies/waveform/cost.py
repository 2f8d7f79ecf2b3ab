"""Processor time of the waveform: live, frame by frame, and in `process`, beside the obvious loop over a log."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import can
import cantools

from yieldmon.bus.codec import Codec
from yieldmon.engine.monitor import Monitor
from yieldmon.frames import GRAIN_CONDITION, Frame
from yieldmon.physics.machine import Machine
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping
from yieldmon.resources import shipped
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk

EMPTY_S, DURATION_S, FLOW_KG_S = 25.0, 145.0, 12.0
ROUNDS = 5
CODEC = Codec()


def traffic(seed: int) -> list[Frame]:
    """Nominal traffic, first of the empty machine."""
    pieces = [
        {"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0},
        {"kind": "steady", "duration_s": DURATION_S, "flow_kg_s": FLOW_KG_S},
    ]
    scenario = from_mapping({"duration_s": DURATION_S, "flow": {"pieces": pieces}}, "cost")
    # cantools takes "not available" for a number.
    combine = VirtualCombine(scenario, Machine(), seed)
    return [f._replace(time_s=1.7e9 + f.time_s) for f in combine.frames_until(DURATION_S) if f.message != GRAIN_CONDITION]


@cache
def _configured(enabled: bool) -> Configuration:
    known = configuration.load(shipped("config/yieldmon.yaml"))
    return replace(known, engine=replace(known.engine, waveform=replace(known.engine.waveform, enabled=enabled)))


def _monitor(enabled: bool) -> Monitor:
    return monitor_of(_configured(enabled))


def _obvious(log: Path, monitor: Monitor, database: Any) -> None:
    with can.LogReader(log) as reader:
        for message in reader:
            signals = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
            name = database.get_message_by_frame_id(message.arbitration_id).name
            monitor.feed(Frame(message.timestamp, name, signals))


def _live(messages: list[can.Message], monitor: Monitor) -> None:
    for message in messages:
        frame = CODEC.decode(message)
        if frame is not None:
            monitor.feed(frame)


def _cpu_ms_per_s(ways: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Least of five rounds after a first, milliseconds of one core for a second of traffic; each round has all ways in turn."""
    spent: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(1 + ROUNDS):
        for name, work in ways.items():
            begin = time.process_time()
            work()
            spent[name].append(time.process_time() - begin)
    return {name: round(1000.0 * min(rounds[1:]) / DURATION_S, 2) for name, rounds in spent.items()}


def report(seed: int) -> dict[str, Any]:
    """Milliseconds of one core for a second of traffic, off and on, by way."""
    messages = [CODEC.encode(frame) for frame in traffic(seed)]
    database = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.log"
        with can.Logger(log) as writer:
            for message in messages:
                message.channel = "can0"
                writer(message)
        ways = {
            f"{way}, {'on' if enabled else 'off'}": partial(run, enabled)
            for enabled in (False, True)
            for way, run in {
                "live": lambda enabled: _live(messages, _monitor(enabled)),
                "process": lambda enabled: process_in_bulk([log], _monitor(enabled), CODEC, lambda row: None),
                "obvious loop": lambda enabled: _obvious(log, _monitor(enabled), database),
            }.items()
        }
        found = _cpu_ms_per_s(ways)
    return {
        "cpu_ms_per_s_of_traffic": found,
        "added_share_of_a_core_pct": round(0.1 * (found["live, on"] - found["live, off"]), 2),
        "obvious_loop_over_process": {s: round(found[f"obvious loop, {s}"] / found[f"process, {s}"], 1) for s in ("off", "on")},
    }
