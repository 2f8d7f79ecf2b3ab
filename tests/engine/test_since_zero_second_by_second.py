"""What seconds miss under another zero, against each reckoned by itself."""

from __future__ import annotations

from dataclasses import replace
from math import isnan, nan
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.sampling.since_zero import KEPT_S, KeptSecond, SinceZero
from yieldmon.engine.settings import EngineSettings, GateSettings, WindowSettings
from yieldmon.physics.machine import Machine

GAIN_N_PER_MV, GRAIN_ON_N, LEAST_COVERAGE = 0.5, 2.0, 0.25
SETTINGS = EngineSettings(gate=GateSettings(grain_on_n=GRAIN_ON_N), windows=WindowSettings(min_coverage=LEAST_COVERAGE))
MACHINE = Machine(sensor=replace(Machine().sensor, gain_n_per_mv=GAIN_N_PER_MV))
#: kg/s of one N.
KG_S_PER_N = 0.25


class Proportional:
    """Flow in proportion to force; none at a plate angle of 0."""

    def estimate(self, force, plate_angle, speed, force_std_dev, moisture):
        return SimpleNamespace(mass_flow_kg_s=np.where(plate_angle > 0.0, KG_S_PER_N * force, nan))


def dry_kg(kg: float, moisture_pct: float) -> float | None:
    return None if isnan(moisture_pct) else 0.5 * kg


def missed(since: SinceZero, zero_mv: float) -> dict[int, MissedMass]:
    return since.missed(zero_mv, Proportional(), dry_kg)


SECONDS = st.builds(
    KeptSecond, load_number=st.sampled_from([NO_LOAD, 1, 2]), duration_s=st.sampled_from([1.0, 0.5]),
    mass_kg=st.sampled_from([0.0, 1.5]), coverage=st.sampled_from([1.0, 0.25, 0.125, 0.0]),
    zero_mv=st.sampled_from([120.0, 122.0, nan]), force_n=st.sampled_from([0.0, 1.0, 2.0, 2.25, 8.0, nan]),
    force_std_dev_n=st.just(0.1), plate_angle_rad=st.sampled_from([1.0, 0.0]), elevator_speed_rad_s=st.just(40.0),
    moisture_pct=st.sampled_from([15.0, nan]), area_m2=st.sampled_from([0.0, 10.0, nan]),
    surplus_frames=st.sampled_from([0, 0, 0, 3]),
)  # fmt: skip


@given(
    st.lists(SECONDS, max_size=8),
    st.dictionaries(st.sampled_from([NO_LOAD, 1, 2]), st.floats(0.0, 50.0), max_size=2),
    st.sampled_from([118.0, 124.0]),
)
def test_each_second_is_measured_again_and_the_scales_mass_taken_back(
    seconds: list[KeptSecond], by_scale: dict[int, float], zero_mv: float
) -> None:
    since = SinceZero(SETTINGS, MACHINE)
    since.add(seconds)
    for number, kg in by_scale.items():
        since.add_scale(number, 0.25 * kg)
        since.add_scale(number, 0.75 * kg)
    expected = {number: [-kg, 0.0, -kg, 0.0] for number, kg in by_scale.items()}
    for second in seconds:
        force_n = second.force_n + (second.zero_mv - zero_mv) * GAIN_N_PER_MV
        if isnan(force_n) or second.coverage == 0.0 or second.surplus_frames:
            continue
        if force_n <= GRAIN_ON_N and not second.mass_kg > 0.0:
            continue
        if force_n > 0.0 and second.plate_angle_rad == 0.0:
            # Without a flow by this zero it stays as it was counted.
            continue
        rate = KG_S_PER_N * max(force_n, 0.0)
        kg = rate * second.duration_s * (1.0 if second.coverage >= LEAST_COVERAGE else second.coverage) - second.mass_kg
        of_load = expected.setdefault(second.load_number, [0.0, 0.0, 0.0, 0.0])
        of_load[0] += kg
        if isnan(second.moisture_pct):
            of_load[2] += kg
        else:
            of_load[1] += 0.5 * kg
        if not second.area_m2 > 0.0:
            of_load[3] += kg
    found = missed(since, zero_mv)
    assert set(found) == set(expected)
    for number, (kg, dry, unknown, unknown_area) in expected.items():
        got = found[number]
        assert (got.kg, got.dry_kg, got.unknown_moisture_kg, got.unknown_area_kg) == pytest.approx(
            (kg, dry, unknown, unknown_area), abs=1e-9
        )


def second(load_number: int, mass_kg: float = 0.0) -> KeptSecond:
    return KeptSecond(load_number, 1.0, mass_kg, 1.0, 118.0, 8.0, 0.1, 1.0, 40.0, 15.0, 10.0)


def test_a_reset_of_the_totals_forgets_what_no_load_was_open_for():
    since = SinceZero(SETTINGS, MACHINE)
    since.add([second(1), second(NO_LOAD), second(2)])
    since.add_scale(NO_LOAD, 5.0)
    since.add_scale(2, 6.0)
    since.totals_reset()
    assert [s.load_number for s in since.seconds] == [1, 2]
    assert since.by_scale == {2: 6.0}


def test_another_zero_forgets_everything():
    since = SinceZero(SETTINGS, MACHINE)
    since.add([second(1)])
    since.add_scale(1, 5.0)
    since.clear()
    assert (since.seconds, since.by_scale, missed(since, 118.0)) == ((), {}, {})


def test_the_newest_are_kept_also_across_a_reset_of_the_totals():
    since = SinceZero(SETTINGS, MACHINE)
    since.add(second(1, float(number)) for number in range(KEPT_S + 5))
    assert (len(since.seconds), since.seconds[0].mass_kg) == (KEPT_S, 5.0)
    since.totals_reset()
    since.add([second(2, -1.0)])
    assert (len(since.seconds), since.seconds[0].mass_kg, since.seconds[-1].mass_kg) == (KEPT_S, 6.0, -1.0)
