"""Cost of decoding a frame and of loading a log, beside python-can and cantools on the same bytes (`tools/bench`)."""

from __future__ import annotations

from pathlib import Path

import can
import cantools
import numpy as np
import pytest

from tests.whole_logs import load_frames
from yieldmon.bus.bulk import decode_block
from yieldmon.bus.codec import Codec
from yieldmon.bus.log_files.logs import read_log
from yieldmon.resources import shipped

FRAMES = 20_000
CODEC = Codec()
SAMPLES = CODEC.layouts["ImpactSensorSamples"]


@pytest.fixture(scope="module")
def database():
    return cantools.database.load_file(shipped("dbc/yieldmon.dbc"))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """20,000 frames of samples and speed as candump writes them."""
    random = np.random.default_rng(20_26)
    path = tmp_path_factory.mktemp("bus") / "drive.log"
    ids = [SAMPLES.frame_id if k % 26 else CODEC.layouts["ElevatorSpeed"].frame_id for k in range(FRAMES)]
    data = random.integers(0, 2**62, FRAMES).tolist()
    path.write_text("".join(f"({1_700_000_000 + k * 0.0038:.6f}) can0 {ids[k]:08X}#{data[k]:016X}\n" for k in range(FRAMES)))
    return path


@pytest.mark.benchmark(group="one frame of samples, decoded")
def test_frame_ours(benchmark):
    message = can.Message(arbitration_id=SAMPLES.frame_id, data=bytes(range(8)))
    assert benchmark(CODEC.decode, message).message == SAMPLES.name


@pytest.mark.benchmark(group="one frame of samples, decoded")
def test_frame_cantools(benchmark, database):
    data = bytes(range(8))
    signals = benchmark(lambda: database.decode_message(SAMPLES.frame_id, data, decode_choices=False))
    assert len(signals) == len(SAMPLES.signals)


@pytest.mark.benchmark(group="a candump log of 20,000 frames, read and decoded")
def test_log_in_bulk(benchmark, log):
    decoded = benchmark(lambda: decode_block(CODEC, load_frames(log)))
    assert sum(len(columns.rows) for columns in decoded.messages.values()) == FRAMES


@pytest.mark.benchmark(group="a candump log of 20,000 frames, read and decoded")
def test_log_frame_by_frame(benchmark, log):
    assert len(benchmark(lambda: [CODEC.decode(message) for message in read_log(log)])) == FRAMES


@pytest.mark.benchmark(group="a candump log of 20,000 frames, read and decoded")
def test_log_with_python_can_and_cantools(benchmark, log, database):
    def load():
        with can.LogReader(log) as reader:
            return [database.decode_message(m.arbitration_id, m.data, decode_choices=False) for m in reader]

    assert len(benchmark(load)) == FRAMES
