"""Waves of a weighed load's seconds: each of its own second, and none lost."""

from __future__ import annotations

import can
import numpy as np
import pytest

from tests.service.bench import CODEC
from yieldmon.errors import InputError
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.physics.machine import RPM
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs import weighed_waves

EMPTY_S, GRAIN_S, FLOWS_KG_S = 8, 12, (8.0, 12.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Two flows in one load."""
    grain = [{"kind": "steady", "duration_s": GRAIN_S, "flow_kg_s": flow} for flow in FLOWS_KG_S]
    flow = {"pieces": [{"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0}, *grain]}
    end_s = EMPTY_S + GRAIN_S * len(FLOWS_KG_S)
    combine = VirtualCombine(from_mapping({"duration_s": end_s, "flow": flow}, "test"), seed=3)
    path = tmp_path_factory.mktemp("log") / "a.log"
    with can.Logger(str(path)) as writer:
        for frame in combine.frames_until(end_s):
            message = CODEC.encode(frame)
            message.channel = "can0"
            writer.on_message_received(message)
    return str(path)


@pytest.fixture(scope="module")
def configured(tmp_path_factory: pytest.TempPathFactory) -> Configuration:
    path = tmp_path_factory.mktemp("configuration") / "c.yaml"
    path.write_text("bus: {}\n")
    return weighed_waves.looking(configuration.load(path))


def test_each_second_of_a_load_has_its_own_wave(log: str, configured: Configuration) -> None:
    (found,) = weighed_waves.read([log], configured)
    numbers = [row.number for row, _ in found.waves]
    assert len(numbers) >= len(FLOWS_KG_S) * (GRAIN_S - 5)
    assert numbers == sorted(set(numbers))
    for row, wave in found.waves:
        # Speeds differ from second to second: those of the neighbours would not do.
        assert wave.elevator_speed_rad_s == pytest.approx(row.elevator_speed_rpm * RPM, rel=1e-12)
    speeds = [wave.elevator_speed_rad_s for _, wave in found.waves]
    assert len(set(speeds)) == len(speeds)


def test_a_ticket_gives_each_wave_the_volume_flow_of_its_weighed_mass(log: str, configured: Configuration) -> None:
    loads = weighed_waves.read([log], configured)
    weighed_kg = 1.1 * loads[0].load.mass_kg
    ticket = WeighedTicket(loads[0].load.name, loads[0].load.name, weighed_kg, 1.0, "line 2")
    shapes = weighed_waves.match(loads, [ticket], configured)
    assert all(item.wave is wave for item, (_, wave) in zip(shapes.waves, loads[0].waves, strict=True))
    density = configured.parameters.values["density"]
    expected = [1.1 * row.mean_force_flow_kg_s / density for row, _ in loads[0].waves]
    np.testing.assert_allclose([item.volume_flow_m3_s for item in shapes.waves], expected)
    with pytest.raises(InputError, match="has a ticket already"):
        weighed_waves.match(loads, [ticket, ticket], configured)
