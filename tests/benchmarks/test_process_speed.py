"""A log through the engine in bulk, beside the obvious loop of python-can and cantools, to the last bit (`tools/bench`).

Twice: windows alone, where reading, decoding and forming windows is all there is, and with the estimator behind them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import can
import cantools
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.service.bench import CODEC, START_S, traffic
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import records_in
from yieldmon.estimation.open_loop import FlowEstimate, FlowStatus
from yieldmon.frames import GRAIN_CONDITION, Frame
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.storage.rows import second_row

LOADED = configuration.load(shipped("config/yieldmon.yaml"))
DURATION_S = 60


class NoFlow:
    """An estimator that costs nothing and says nothing: what is left are the windows."""

    parameters = LOADED.parameters

    def estimate(self, *_: object) -> FlowEstimate:
        none = np.array(np.nan)
        return FlowEstimate(none, none, np.array(int(FlowStatus.NOT_AVAILABLE)), none)


def windows_only() -> Monitor:
    return Monitor(LOADED.engine, LOADED.machine, NoFlow())


def with_estimator() -> Monitor:
    return build_monitor(LOADED.engine, LOADED.machine, LOADED.parameters)


MONITORS = {"windows": windows_only, "windows and flow": with_estimator}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("speed") / "drive.log"
    with can.Logger(str(path)) as logger:
        for start_s, duration_s, mv in ((START_S, 14.0, 0.0), (START_S + 14.0, DURATION_S - 14.0, 60.0)):
            for frame in traffic(start_s, duration_s, mv):
                if frame.message == GRAIN_CONDITION:
                    continue  # its "not available" is a number to cantools
                message = CODEC.encode(frame)
                message.channel = "can0"
                logger.on_message_received(message)
    return path


def in_bulk(log: Path, monitor: Monitor) -> list:
    rows: list = []
    process_in_bulk([log], monitor, CODEC, rows.append)
    return rows


def obvious_loop(log: Path, monitor: Monitor, database: cantools.database.Database) -> list:
    """As one writes it first: a message, its signals, the monitor."""
    rows: list = []
    with can.LogReader(log) as reader:
        for message in reader:
            signals = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
            name = database.get_message_by_frame_id(message.arbitration_id).name
            for record in records_in(monitor.feed(Frame(message.timestamp, name, signals))):
                rows.append(second_row(len(rows) + 1, record))
    return rows


@pytest.mark.parametrize("what", MONITORS)
def test_in_bulk(benchmark, log, what):
    benchmark.group = f"{DURATION_S} s of log to rows ({what})"
    assert len(benchmark.pedantic(lambda: in_bulk(log, MONITORS[what]()), rounds=5, warmup_rounds=1)) == DURATION_S - 1


@pytest.mark.parametrize("what", MONITORS)
def test_obvious_loop(benchmark, log, what):
    benchmark.group = f"{DURATION_S} s of log to rows ({what})"
    database = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
    rows = benchmark.pedantic(lambda: obvious_loop(log, MONITORS[what](), database), rounds=2)
    assert rows == in_bulk(log, MONITORS[what]())
