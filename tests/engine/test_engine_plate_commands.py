"""No input can command the plate out of range or faster than its rate."""

from __future__ import annotations

import math

from engine_bench import MACHINE
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.settings import PlateSettings
from yieldmon.engine.sweeps.plate_commands import RELEASE, PlateCommander, PlateDemand
from yieldmon.frames import NOT_AVAILABLE, CommandMode

DEMANDS = st.builds(PlateDemand, mode=st.sampled_from(CommandMode), target_deg=st.floats(allow_nan=True, allow_infinity=True))
MEASURED = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(0.0, 180.0))


@given(st.lists(st.tuples(DEMANDS, MEASURED), max_size=50), st.floats(0.5, 90.0))
def test_every_command_is_within_range_and_rate(demands: list[tuple[PlateDemand, float]], rate_deg_s: float) -> None:
    commander = PlateCommander(PlateSettings(max_rate_deg_s=rate_deg_s), MACHINE)
    last = None
    for number, (demand, measured) in enumerate(demands):
        signals = commander.command(demand, measured)
        assert signals["CommandCounter"] == number % 256
        target = signals["TargetPlateAngle"]
        if signals["CommandMode"] == CommandMode.RELEASE:
            assert target is NOT_AVAILABLE
            last = None
            continue
        assert isinstance(target, float)
        assert commander.min_deg <= target <= commander.max_deg
        if last is not None:
            assert abs(target - last) <= rate_deg_s * 0.1 + 1e-9
        last = target


def test_a_target_that_is_no_number_is_refused_by_going_home() -> None:
    commander = PlateCommander(PlateSettings(), MACHINE)
    signals = commander.command(PlateDemand(CommandMode.GO_TO_ANGLE, math.nan), 70.0)
    assert signals["CommandMode"] == CommandMode.GO_HOME
    assert signals["TargetPlateAngle"] == commander.home_deg


def test_the_first_target_starts_from_where_the_plate_is() -> None:
    commander = PlateCommander(PlateSettings(), MACHINE)
    first = commander.command(PlateDemand(CommandMode.GO_TO_ANGLE, 90.0), 45.0)
    assert first["TargetPlateAngle"] == 47.0
    commander.command(RELEASE, 47.0)
    again = commander.command(PlateDemand(CommandMode.GO_HOME), 80.0)
    assert again["TargetPlateAngle"] == 78.0
