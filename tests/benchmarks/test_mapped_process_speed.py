"""A log of a foreign bus through the engine by a mapping, beside the obvious loop of python-can and cantools (`tools/bench`)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import can
import cantools
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.signals.layouts import MULTIPLEXED
from yieldmon.bus.codec import Codec
from yieldmon.engine.results import records_in
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.storage.rows import second_row

DURATION_S = 60


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("mapped")
    config = MULTIPLEXED.write(folder)
    combine = VirtualCombine(scenario.from_mapping({"duration_s": float(DURATION_S)}, "mapped"), Machine(), 1)
    log = folder / "drive.log"
    with can.Logger(str(log)) as logger:
        for message in sorted(MULTIPLEXED.messages(combine.frames_until(DURATION_S), 1.79e9), key=lambda each: each.timestamp):
            logger.on_message_received(message)
    return log, config


def in_bulk(log: Path, config: Path) -> list[Any]:
    rows: list[Any] = []
    loaded = configuration.load(config)
    process_in_bulk([log], monitor_of(loaded), Codec(), rows.append, signals=loaded.signals)
    return rows


def obvious_loop(log: Path, config: Path) -> list[Any]:
    """As one writes it first: a message, its signals by cantools, the quantity by hand, the monitor."""
    rows: list[Any] = []
    database = cantools.database.load_file(config.with_suffix(".dbc"))
    loaded = configuration.load(config)
    monitor = monitor_of(loaded)
    sample, speed, angle = (group.name for group in loaded.signals.groups)
    with can.LogReader(log) as reader:
        for message in reader:
            signals = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
            if "Voltage" in signals:
                frame = Frame(message.timestamp, sample, {"impact0.0": signals["Voltage"]})
            elif "Speed" in signals:
                frame = Frame(message.timestamp, speed, {"elevator_speed": signals["Speed"] / RPM})
            else:
                frame = Frame(message.timestamp, angle, {"plate_angle": signals["Angle"] * 57.29577951308232})
            rows += [second_row(len(rows) + 1, record) for record in records_in(monitor.feed(frame))]
    return rows


def test_in_bulk(benchmark, drive):
    benchmark.group = f"{DURATION_S} s of a mapped log to rows"
    assert len(benchmark.pedantic(lambda: in_bulk(*drive), rounds=5, warmup_rounds=1)) == DURATION_S - 1


def test_obvious_loop(benchmark, drive):
    benchmark.group = f"{DURATION_S} s of a mapped log to rows"
    rows = benchmark.pedantic(lambda: obvious_loop(*drive), rounds=2)
    expected = in_bulk(*drive)
    assert rows[-1].total_kg == pytest.approx(expected[-1].total_kg, rel=1e-9)
