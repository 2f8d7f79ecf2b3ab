"""Whether the daemon believes the reported elevator speed, on pulses of the discrete-element engine, which it has no part in."""

from __future__ import annotations

from dataclasses import replace

import pytest

from studies.waveform import placed
from studies.waveform.kernels import FORCES, MORE_FORCES, heaps
from studies.waveform.placed_pulses import Chain, train
from yieldmon import frames
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import events_in
from yieldmon.engine.settings import EngineSettings, SweepSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel

CELL_S, SEED = 0.0002, 8801
GRAIN = {"friction": 0.3, "density": 710.0, "shape_ratio": 2.9, "restitution": 0.3}
WRONG_S = 60.0, 63.0
UNEVEN = ("even, loads scatter by 15 %", "polygon of 8 teeth", "by 2 mm", "3 mm", "5 %", "four of 36 missing")


def shown(chain: Chain, group: str, wrong: float = 1.0) -> list[float]:
    """Times at which SpeedMissing appears. wrong: reported over true speed within WRONG_S."""
    machine = replace(placed.MACHINE, sensor=replace(placed.MACHINE.sensor, response_s=CELL_S))
    key = placed.GROUPS[group]
    made = train(
        placed.of_group(heaps(FORCES, MORE_FORCES), key), chain, spacing_m=machine.paddle_spacing_m,
        speed_m_s=float(machine.paddle_speed_m_s(placed.RPM_TOLD * RPM)), cell_s=CELL_S,
        gain_n_per_mv=machine.sensor.gain_n_per_mv, end_s=placed.END_S, seed=SEED,
    )  # fmt: skip
    settings = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False))
    monitor, found = Monitor(settings, machine, OpenLoop(ForwardModel(machine, ()), ParameterSet(GRAIN))), []
    for frame in placed.traffic(made, chain, key[2], SEED):
        sent = frame
        if frame.message == frames.ELEVATOR_SPEED and WRONG_S[0] <= frame.time_s < WRONG_S[1]:
            speed = frame.signals["ElevatorSpeed"]
            assert isinstance(speed, float)
            sent = frame._replace(signals={"ElevatorSpeed": wrong * speed})
        found += [e for e in events_in(monitor.feed(sent)) if isinstance(e, FaultEvent)]
    return [event.time_s for event in found if event.code == "SpeedMissing" and event.active]


@pytest.mark.parametrize("group", ["0.2 kg", "0.5 kg"])
@pytest.mark.parametrize(
    "name", ["even, loads scatter by 15 %", "polygon of 8 teeth", "by 2 mm", "3 mm", "5 %", "four of 36 missing"]
)
def test_no_uneven_chain_contradicts_a_right_speed(name: str, group: str) -> None:
    assert shown(placed.CHAINS[name], group) == []


@pytest.mark.parametrize("group", ["0.2 kg", "0.5 kg"])
@pytest.mark.parametrize("wrong", [0.67, 0.75, 0.9, 1.1, 1.25])
def test_a_wrong_speed_is_seen(wrong: float, group: str) -> None:
    times = shown(placed.CHAINS["even, loads scatter by 15 %"], group, wrong)
    assert times
    assert all(WRONG_S[0] <= time_s <= WRONG_S[1] + 1.0 for time_s in times)
