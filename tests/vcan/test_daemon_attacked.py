"""`yieldmon run` on real SocketCAN when the bus is flooded and frames are forged. The attackers are can-utils."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.vcan.drives import SCENARIO, SWEEP
from tests.vcan.nodes import CODEC, candump, combine, daemon, eventually, read_back
from yieldmon import frames
from yieldmon.frames import CommandMode

pytestmark = pytest.mark.vcan

#: Of the highest priority 1,400 frames a second, and 50 of each of our inputs: with the combine's own more than a bus can take.
FLOOD_GAP_MS, FORGED_GAP_MS = 0.7, 20.0
ATTACK_WINDOWS = 12
MEMORY_GROWTH_KB = 20_000


@contextmanager
def babbling(channel: str) -> Iterator[None]:
    """The highest-priority id without end, and each of our inputs' ids with any length and any data."""
    attacks = [["-g", str(FLOOD_GAP_MS), "-I", "000", "-L", "8"]]
    forged = (f"{CODEC.layouts[message].frame_id:08X}" for message in frames.INPUTS)
    attacks += [["-g", str(FORGED_GAP_MS), "-e", "-I", identifier] for identifier in forged]
    generators = [subprocess.Popen(["cangen", channel, "-i", *attack]) for attack in attacks]
    try:
        yield
        assert [generator.poll() for generator in generators] == [None] * len(generators)
    finally:
        for generator in generators:
            generator.kill()
            generator.wait()


def test_babbling_idiots_in_the_middle_of_a_sweep(vcan0: str, tmp_path: Path) -> None:
    """No exception, bounded memory, right faults, no command out of range, and health afterwards."""
    log = tmp_path / "candump.log"
    with daemon(vcan0, tmp_path, SWEEP % "home_rest_s: 3") as node, candump(vcan0, log), combine(vcan0, tmp_path, SCENARIO):
        eventually(lambda: node.status["sweep"]["progress_pct"] > 0.0, "a sweep under way")
        before_kb = node.resident_kb
        with babbling(vcan0):
            first = node.windows
            eventually(lambda: node.windows >= first + ATTACK_WINDOWS, "windows under fire")
        assert node.resident_kb - before_kb < MEMORY_GROWTH_KB
        assert node.status["bus"]["malformed"] > 0
        assert node.status["bus"]["dropped"] == node.status["bus"]["kernel_drops"] == 0
        eventually(lambda: "FramesLost" not in node.faults, "the end of the faults")
        eventually(lambda: node.status["windows"][-1]["mass_flow_kg_s"] is not None, "flow again")
    with node.store() as store:
        codes = {event.code for event in store.faults() if event.active}
    assert {"FramesLost", "SweepAborted"} <= codes
    assert "StoreFailing" not in codes
    commands = [frame.signals for frame in read_back(log, only=frames.PLATE_ACTUATOR_COMMAND)]
    targets = [c["TargetPlateAngle"] for c in commands if c["CommandMode"] == CommandMode.GO_TO_ANGLE]
    assert targets
    assert 40.0 <= min(targets) <= max(targets) <= 90.0


def test_our_message_from_cansend_is_a_conflict(vcan0: str, tmp_path: Path) -> None:
    identifier = CODEC.layouts[frames.MASS_FLOW].frame_id
    with daemon(vcan0, tmp_path) as node:
        eventually(lambda: node.windows > 1, "windows on a silent bus")
        assert "OutputConflict" not in node.faults, "our own frames are no conflict"

        def reported() -> bool:
            subprocess.run(["cansend", vcan0, f"{identifier:08X}#0000000000000000"], check=True)
            return "OutputConflict" in node.faults

        eventually(reported, "OutputConflict")
        assert node.faults["OutputConflict"] == "MassFlow from another node"
