"""Calibration by loads: a scale is believed, one load among many is not, and what loads cannot tell is held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shipped_grain import MACHINE, MODEL, SHIPPED

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.weighing.density_and_gain import moved
from yieldmon.estimation.weighing.load_departures import departure
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.estimation.weighing.wrong_tickets import contradicted
from yieldmon.physics.model import Conditions

FAR = {"friction": 0.21, "density": 1075.0 * 1.18, "shape_ratio": 2.0, "restitution": 1.55 * 0.87 - 1.0}


def load(
    name: str, flow: float, factor: float = 1.0, truth: dict[str, float] = FAR, sd: float = 0.003, seed: int = 0
) -> WeighedLoad:
    """600 s at about a flow, weighed `factor` times what it was, within its standard deviation."""
    rng = np.random.default_rng([seed, round(1000 * flow)])
    flows = np.clip(flow * (1.0 + 0.2 * rng.standard_normal(600)), 0.5 * flow, 1.3 * flow)
    angle, speed = np.full(600, MACHINE.home_plate_angle_rad), np.full(600, MACHINE.nominal_elevator_speed_rad_s)
    force = np.real(MODEL.force(Conditions(angle, speed, mass_flow_kg_s=flows), truth))
    kg = float(flows.sum()) * factor
    return WeighedLoad(name, kg * (1.0 + sd * rng.standard_normal()), sd * kg, np.ones(600), force, angle, speed)


def error_pct(known: ParameterSet, flow: float, truth: dict[str, float] = FAR) -> float:
    angle, speed = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
    force = float(np.real(MODEL.force(Conditions(angle, speed, mass_flow_kg_s=flow), truth)))
    return 100.0 * (float(OpenLoop(MODEL, known).invert(force, angle, speed)) / flow - 1.0)


@pytest.mark.parametrize("factor", [0.6, 0.7, 1.3, 1.6])
def test_one_load_far_from_the_shipped_crop_is_learnt(factor):
    found = calibrate_loads(MODEL, SHIPPED, [load("1", 12.0, factor, dict(SHIPPED.values))])
    assert found.loads[0].after_kg == pytest.approx(found.loads[0].weighed_kg, rel=0.003)
    assert not found.load_dependence
    assert 0.002 < found.next_load_sd < 0.01
    assert np.isnan(found.loads[0].left_out_error)


def test_three_loads_determine_the_scale_and_its_dependence_on_the_load():
    found = calibrate_loads(MODEL, SHIPPED, [load("a", 4.0), load("b", 11.0), load("c", 19.0)])
    assert found.load_dependence
    assert not found.refused
    for flow in (3.0, 8.0, 14.0, 22.0):
        assert abs(error_pct(SHIPPED, flow)) > 2.5
        assert abs(error_pct(found.parameter_set, flow)) < 1.0
    assert {"friction", "shape_ratio"} <= set(found.held)
    assert found.parameter_set.standard_deviation("friction") == pytest.approx(0.004)
    assert found.parameter_set.version == SHIPPED.version + 1


@pytest.mark.parametrize("tare_kg", [1500.0, 2200.0])
def test_a_constant_in_every_weighed_mass_is_reported(tare_kg):
    fair = [load(str(flow), flow, truth=dict(SHIPPED.values), sd=0.001) for flow in (5.0, 9.0, 14.0, 19.0)]
    assert calibrate_loads(MODEL, SHIPPED, fair).wrong_ticket is None
    wrong = [replace(one, weighed_kg=one.weighed_kg + tare_kg) for one in fair]
    found = calibrate_loads(MODEL, SHIPPED, wrong)
    assert found.wrong_ticket is not None
    assert found.wrong_ticket.apart_kg == pytest.approx(tare_kg, rel=0.1)
    assert any("as if the tare was not taken off" in sentence for sentence in found.sentences)


def test_another_grain_is_no_constant():
    found = calibrate_loads(MODEL, SHIPPED, [load("a", 4.0), load("b", 11.0), load("c", 19.0), load("d", 7.0)])
    assert found.load_dependence
    assert found.wrong_ticket is None


def test_loads_at_one_flow_hold_what_they_do_not_determine():
    found = calibrate_loads(MODEL, SHIPPED, [load(str(k), 10.0, seed=k) for k in range(3)])
    assert not found.load_dependence
    assert abs(error_pct(found.parameter_set, 10.0)) < 0.5
    flow_sd = {
        flow: float(
            OpenLoop(MODEL, found.parameter_set)
            .estimate(
                float(
                    np.real(
                        MODEL.force(
                            Conditions(MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s, mass_flow_kg_s=flow),
                            FAR,
                        )
                    )
                ),
                MACHINE.home_plate_angle_rad,
                MACHINE.nominal_elevator_speed_rad_s,
            )
            .std_dev_kg_s
            / flow
        )
        for flow in (3.0, 9.7, 10.0, 10.3, 20.0)
    }
    assert found.next_load_sd < 0.01
    for flow in (9.7, 10.0, 10.3):
        assert flow_sd[flow] < 0.025
        assert abs(error_pct(found.parameter_set, flow)) < 200.0 * flow_sd[flow]
    assert flow_sd[3.0] > 3.0 * flow_sd[10.0]
    assert flow_sd[20.0] > 3.0 * flow_sd[10.0]


@pytest.mark.parametrize("factor", [0.7, 0.85, 1.15, 1.4])
def test_a_load_with_another_trucks_grain_is_named_and_moves_nothing(factor):
    three = [load("a", 6.0), load("b", 11.0), load("c", 16.0)]
    before = calibrate_loads(MODEL, SHIPPED, three)
    after = calibrate_loads(MODEL, SHIPPED, [*three, load("d", 9.0, factor)])
    assert after.outliers == ("d",)
    assert "load d contradicts the others" in after.sentences[0]
    for flow in (5.0, 12.0, 18.0):
        assert abs(error_pct(after.parameter_set, flow) - error_pct(before.parameter_set, flow)) < 0.1


def test_tickets_beyond_what_a_paddle_carries_name_a_load_with_its_masses():
    """Pounds in a column of kilograms on a machine that measures half."""
    with pytest.raises(ValueError, match=r"full paddle .*: load [abc], weighed \d+ kg, measured \d+ kg"):
        calibrate_loads(MODEL, SHIPPED, [load("a", 6.0, 4.6), load("b", 11.0, 4.6), load("c", 16.0, 4.6)])


@pytest.mark.parametrize(("factor", "asked"), [(2.2046, True), (0.4536, True), (1.1, False)])
def test_a_scale_that_changes_by_a_lot_is_asked_about(factor, asked):
    """Such as pounds in a column of kilograms."""
    found = calibrate_loads(
        MODEL, SHIPPED, [load(n, f, factor, dict(SHIPPED.values)) for n, f in (("a", 3.0), ("b", 5.0), ("c", 8.0))]
    )
    assert any("in the unit of their column" in sentence for sentence in found.sentences) is asked


def test_among_three_the_wrong_one_is_not_identifiable():
    found = calibrate_loads(MODEL, SHIPPED, [load("a", 6.0), load("b", 11.0), load("c", 16.0, 1.2)])
    assert found.outliers == ()


def test_a_calibration_that_is_worse_on_left_out_loads_is_refused():
    true = ParameterSet(FAR, SHIPPED.covariance_names, SHIPPED.covariance)
    loads = [load(str(k), flow, seed=40 + k, sd=0.005) for k, flow in enumerate((6.0, 11.0, 16.0))]
    found = calibrate_loads(MODEL, true, loads)
    assert found.refused
    assert found.parameter_set is true
    assert found.rms_left_out > found.rms_before
    assert [r.before_kg for r in found.loads] == [r.after_kg for r in found.loads]


@pytest.mark.parametrize(("gain", "form"), [(0.9, "restitution"), (0.6, "k2"), (1.2, "restitution"), (1.4, "k2")])
def test_a_gain_that_no_restitution_has_is_carried_by_an_exchange_coefficient(gain, form):
    known = moved(SHIPPED, 0.0, float(np.log(gain)))
    assert form in known.values
    at = Conditions(MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s, mass_flow_kg_s=9.0)
    ratio = np.real(MODEL.force(at, known.values)) / np.real(MODEL.force(at, SHIPPED.values))
    assert float(ratio) == pytest.approx(gain, rel=1e-9)
    assert set(known.covariance_names) == {"friction", "density", form}


def test_sweeps_beside_the_loads_determine_friction():
    wide = replace(SHIPPED, covariance=np.diag([0.06**2, 150.0**2, 0.15**2]))
    rng, sweeps = np.random.default_rng(1), []
    for flow in (8.0, 14.0):
        angle = np.radians(np.repeat([70.0, 40.0, 70.0, 90.0, 70.0, 50.0, 70.0, 80.0, 70.0, 60.0], 2))
        speed = np.full(angle.size, MACHINE.nominal_elevator_speed_rad_s)
        force = np.real(MODEL.force(Conditions(angle, speed, mass_flow_kg_s=flow), FAR | {"friction": 0.25}))
        noisy = force * (1.0 + 0.001 * rng.standard_normal(angle.size))
        sweeps.append(Sweep(np.arange(angle.size, dtype=float), angle, speed, noisy, 0.001 * force))
    loads = [load(str(k), f, truth=FAR | {"friction": 0.25}) for k, f in enumerate((5.0, 11.0, 17.0))]
    with_sweeps = calibrate_loads(MODEL, wide, loads, sweeps=sweeps, sweep_settings=ClosedLoopSettings())
    without = calibrate_loads(MODEL, wide, loads)
    assert with_sweeps.sweeps_used == 2
    assert abs(with_sweeps.parameter_set.values["friction"] - 0.25) < 0.03
    assert without.parameter_set.values["friction"] == wide.values["friction"]
    for flow in (5.0, 11.0, 17.0):
        assert abs(error_pct(with_sweeps.parameter_set, flow, FAR | {"friction": 0.25})) < 0.8


def test_the_stated_deviation_covers_further_loads():
    """68 and 95 % of further loads, over calibrations from three loads with a scale's scatter."""
    inside = []
    for seed in range(8):
        loads = [load(str(k), f, seed=seed, sd=0.005) for k, f in enumerate((5.0, 11.0, 17.0))]
        found = calibrate_loads(MODEL, SHIPPED, loads)
        inside += [abs(error_pct(found.parameter_set, flow)) / (100.0 * found.next_load_sd) for flow in (5.0, 9.0, 13.0, 17.0)]
    inside = np.array(inside)
    assert np.mean(inside < 2.0) > 0.85
    assert np.mean(inside < 0.5) < 0.7


def test_what_contradicts_is_reported_in_per_cent_of_the_measured_mass():
    before = [load("a", 6.0), load("b", 11.0), load("c", 16.0)]
    found = contradicted(MODEL, SHIPPED, before, load("d", 9.0, 1.2))
    assert found == pytest.approx(0.2, abs=0.02)
    assert contradicted(MODEL, SHIPPED, before, load("d", 9.0)) is None
    assert contradicted(MODEL, SHIPPED, before[:2], load("d", 9.0, 1.2)) is None


def test_no_loads_and_nonsense_are_refused():
    with pytest.raises(ValueError, match="no weighed load"):
        calibrate_loads(MODEL, SHIPPED, [])
    with pytest.raises(ValueError, match="expected above 0"):
        replace(load("a", 6.0), weighed_kg=0.0)
    with pytest.raises(ValueError, match="expected 0 or above"):
        replace(load("a", 6.0), noise_sd=np.nan)
    with pytest.raises(ValueError, match="one finite number"):
        replace(load("a", 6.0), force_n=np.array([np.nan]))


@pytest.mark.parametrize(
    ("flows", "noise_sd", "named"),
    [((8.8, 9.0, 9.2), 0.0, True), ((8.8, 9.0, 9.2), 0.006, False), ((6.0, 11.0, 16.0), 0.0, False)],
)
def test_neither_scatter_nor_another_curve_of_the_force_is_another_trucks_grain(flows, noise_sd, named):
    """2.5 % off: wrong among loads of one flow, but not of 45 s of seconds that scatter by 4 %, nor between other flows."""
    three = [load(name, flow) for name, flow in zip("abc", flows, strict=True)]
    short = replace(load("d", 9.1, 1.025, sd=1e-4), std_dev_kg=0.003 * 5460.0, noise_sd=noise_sd)
    found = calibrate_loads(MODEL, SHIPPED, [*three, short])
    assert (found.outliers == ("d",)) is named
    assert (contradicted(MODEL, SHIPPED, three, short) is not None) is named


def of_a_law(exponent: float, flows: tuple[float, ...], seed: int = 0) -> list[WeighedLoad]:
    """Loads of a machine whose force is a power of the flow, which no parameters of the model give."""
    out = []
    for k, flow in enumerate(flows):
        rng = np.random.default_rng([seed, k])
        each = np.clip(flow * (1.0 + 0.2 * rng.standard_normal(600)), 0.5 * flow, 1.4 * flow)
        angle, speed = np.full(600, MACHINE.home_plate_angle_rad), np.full(600, MACHINE.nominal_elevator_speed_rad_s)
        kg = float(each.sum())
        out.append(WeighedLoad(str(k), kg, 0.005 * kg, np.ones(600), 8.0 * each**exponent, angle, speed))
    return out


LAWS = [
    (1.0, (6.0, 12.0, 9.0), 14.0),
    (0.8, (7.3, 5.4, 11.9), 9.8),
    (1.15, (7.1, 12.9, 9.5), 4.7),
    (1.15, (5.0, 9.0, 15.0), 11.0),
]


@pytest.mark.parametrize(("exponent", "flows", "next_flow"), LAWS)
def test_where_the_force_follows_another_law_the_stated_deviation_says_so(exponent, flows, next_flow):
    loads = of_a_law(exponent, flows)
    found = calibrate_loads(MODEL, SHIPPED, loads)
    assert found.outliers == ()
    (further,) = of_a_law(exponent, (next_flow,))
    error, std_dev = departure(MODEL, found.parameter_set, further)
    assert abs(error) < 2.5 * std_dev
    assert found.another_law is not None
    assert abs(error) < 0.05


@pytest.mark.parametrize("exponent", [0.9, 1.0, 1.15])
def test_right_tickets_of_another_law_are_no_other_trucks_grain(exponent):
    found = calibrate_loads(MODEL, SHIPPED, of_a_law(exponent, (7.1, 12.9, 9.5, 4.7)))
    assert found.outliers == ()
    fitted = [abs(load.after_kg / load.weighed_kg - 1.0) for load in found.loads]
    assert found.next_load_sd > 0.7 * np.sqrt(np.mean(np.square(fitted)))


def test_what_the_model_leaves_of_a_published_table_is_what_the_settings_say():
    """Of momentum over fill at each angle, with density and gain fitted there."""
    table = np.genfromtxt(Path(__file__).parents[1] / "data/dem_table.csv", delimiter=",", names=True)
    left = []
    for angle in np.unique(table["plate_angle_deg"]):
        fills = np.unique(table["paddle_mass_kg"])[1:]
        here = table["plate_angle_deg"] == angle
        measured = [table["momentum_kg_m_s"][here & (table["paddle_mass_kg"] == fill)].mean() for fill in fills]
        at = Conditions(np.radians(angle), MACHINE.nominal_elevator_speed_rad_s, paddle_mass_kg=fills)
        errors = []
        for density in 1075.0 * np.exp(np.linspace(-0.5, 1.0, 31)):
            error = np.log(np.real(MODEL.paddle_momentum(at, {**SHIPPED.values, "density": density}, overfull="nan")) / measured)
            errors.append(error - error.mean())
        left.append(min(float(np.mean(error**2)) for error in errors if np.all(np.isfinite(error))))
    assert LoadSettings().law_error == pytest.approx(np.sqrt(np.mean(left)), rel=0.25)


def test_a_next_load_like_short_ones_is_as_uncertain_as_their_scatter():
    loads = [replace(load(name, flow), noise_sd=0.008) for name, flow in (("a", 6.0), ("b", 11.0), ("c", 16.0))]
    assert calibrate_loads(MODEL, SHIPPED, loads).next_load_sd > 0.008


@pytest.mark.parametrize(("flows", "seed"), [((8.0, 11.0, 15.0), 1), ((9.0, 11.0, 13.0), 4)])
def test_loads_that_one_factor_explains_still_bound_how_the_error_changes_with_flow(flows, seed):
    truth = dict(SHIPPED.values)
    found = calibrate_loads(MODEL, SHIPPED, [load(str(k), f, 1.1, truth, 0.006, seed) for k, f in enumerate(flows)])
    assert not found.load_dependence
    assert found.next_load_sd < 0.012


@pytest.mark.parametrize(("shared", "own"), [(1, 0), (3, 0), (10, 0), (10, 1)])
def test_trucks_that_another_combine_filled_too_know_the_scale_no_better_than_its_monitor(shared, own):
    """Its monitor shows 3 % too much of as much grain as is this one's."""
    of_shared = [load(str(k), 9.0 + 1.5 * (k % 3), 0.97, seed=k) for k in range(shared)]
    trucks = [replace(one, std_dev_kg=0.032 * one.weighed_kg, common_kg=0.03 * one.weighed_kg) for one in of_shared]
    known = calibrate_loads(MODEL, SHIPPED, [*trucks, *(load(f"own {k}", 12.0) for k in range(own))]).parameter_set
    _, stated = departure(MODEL, known, load("next", 11.0, sd=1e-4))
    error = abs(error_pct(known, 11.0)) / 100.0
    assert stated > (0.027 if not own else 0.0)
    assert error < 2.0 * stated
    assert error < (0.04 if not own else 0.01)
