"""Volume flow from pulse shape: symmetry, agreement with the virtual combine's own throws, Fisher against Monte Carlo."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from studies.waveform.arrival import calibrate_arrival, sample_noise_n
from studies.waveform.load_contrast import contrast, expected_exponent, flow_of
from tests.estimation.one_window import fold, harmonics_of, residual
from yieldmon.estimation.waveform import arrival_law, pulse_fit, pulse_model, pulse_shape
from yieldmon.estimation.waveform.pattern_fold import FoldedPattern, PatternWave
from yieldmon.estimation.waveform.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.waveform.pulse_residuals import residuals_of_pulses
from yieldmon.physics import pulse
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.throw import throw

MACHINE = Machine()
GRAIN = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
MODEL = ForwardModel(MACHINE, ("gravity",))
SPEED = 400.0 * RPM
HOME = np.deg2rad(70.0)


def pulses(**changes: object) -> PulseModel:
    return PulseModel(MODEL, GRAIN, PulseSettings(**changes))  # type: ignore[arg-type]


def noise(model: PulseModel) -> np.ndarray:
    return sample_noise_n(model, sample_sd_n=1.33, samples=1000.0)


def plant_wave(flow_kg_s: float, harmonics: int, cell_s: float) -> np.ndarray:
    """Harmonics of the pattern from the virtual combine's parcels, which share no code with the estimator's model."""
    speed = MACHINE.paddle_speed_m_s(SPEED)
    base = 2.0 * np.pi * speed / MACHINE.pattern_length_m
    omega = base * np.arange(1, harmonics + 1)
    total = np.zeros(harmonics, dtype=complex)
    for place, gap in zip(np.cumsum(MACHINE.paddle_spacings_m), MACHINE.paddle_spacings_m, strict=True):
        parcels = throw(MACHINE, Grain(), Effects(), flow_kg_s * gap / speed, HOME, SPEED)
        struck = parcels.impulse_n_s > 0.0
        when = parcels.arrival_s[struck] + place / speed
        total += (parcels.impulse_n_s[struck] * np.exp(-1j * np.outer(omega, when))).sum(axis=1)
    return total * base / (2.0 * np.pi) / (1.0 + 1j * omega * cell_s) ** 2


@pytest.mark.parametrize("mass_kg", [0.2, 0.5, 0.9, 1.5])
@pytest.mark.parametrize("angle_deg", [50.0, 70.0, 90.0])
def test_arrival_agrees_with_the_virtual_combine_s_parcels(mass_kg: float, angle_deg: float) -> None:
    found = pulse.arrivals(MODEL.throw(np.deg2rad(angle_deg), SPEED, GRAIN), mass_kg)
    parcels = throw(MACHINE, Grain(), Effects(), mass_kg, np.deg2rad(angle_deg), SPEED)
    weight, when = parcels.impulse_n_s.ravel(), parcels.arrival_s.ravel()
    weight, when = weight[weight > 0.0], when[weight > 0.0]
    mean = (weight * when).sum() / weight.sum()
    sd = np.sqrt((weight * (when - mean) ** 2).sum() / weight.sum())
    assert float(found.mean_s) == pytest.approx(mean, abs=2e-4)
    # The combine spreads grain over seven layers; the model evenly.
    assert float(found.sd_s) == pytest.approx(sd, rel=0.02)
    assert float(found.total_n_s) == pytest.approx(weight.sum(), rel=0.01)


def test_spectrum_at_low_frequency_is_the_impulse() -> None:
    parts = pulse.arrivals(MODEL.throw(HOME, SPEED, GRAIN), 0.5)
    assert abs(pulse.spectrum(parts, np.array([1e-6]))[0]) == pytest.approx(float(parts.total_n_s))


@pytest.mark.parametrize("flow_kg_s", [4.0, 8.0, 18.0])
def test_finds_the_volume_flow_of_the_virtual_combine(flow_kg_s: float) -> None:
    model = pulses(model_error=0.01)
    wave = PatternWave(plant_wave(flow_kg_s, 24, 0.008), noise(model), 6.0, SPEED, HOME)
    found = pulse_shape.estimate(model, wave)
    assert found.converged
    assert found.volume_flow_m3_s == pytest.approx(flow_kg_s / 1100.0, rel=0.04)
    assert abs(np.log(found.volume_flow_m3_s * 1100.0 / flow_kg_s)) < 3.0 * found.relative_sd


def test_size_and_shift_of_the_pulses_do_not_matter() -> None:
    """(flow, density, 1 + e) -> (a, a, 1/a) and the phase of the chain leave the volume flow as it is."""
    model = pulses()
    plain = plant_wave(8.0, 24, 0.008)
    turned = 1.7 * plain * np.exp(-2j * np.pi * 0.31 * np.arange(1, 25))
    # Noise in the same proportion, for else the louder wave is weighed differently.
    model_louder = pulses(vibration_n=1.7 * 3.0)
    first = pulse_shape.estimate(model, PatternWave(plain, noise(model), 6.0, SPEED, HOME))
    second = pulse_shape.estimate(model_louder, PatternWave(turned, 1.7 * noise(model), 6.0, SPEED, HOME))
    assert second.volume_flow_m3_s == pytest.approx(first.volume_flow_m3_s, rel=2e-3)


def linear(model: PulseModel, theta: np.ndarray, where: tuple[float, float]) -> pulse_model.Linear:
    """The model at one point."""
    found = model.linearised(theta[None], np.array([where[0]]), np.array([where[1]]))
    return pulse_model.Linear(found.waves[0], found.jacobian[0], found.envelope[0])


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize(
    ("flow_kg_s", "angle_deg", "rpm"), [(1.0, 70.0, 400.0), (8.0, 47.3, 331.0), (18.0, 88.0, 452.0), (25.0, 63.0, 390.0)]
)
def test_linearised_harmonics_are_those_of_the_stages(flow_kg_s: float, angle_deg: float, rpm: float, indexed: bool) -> None:
    """Value and every derivative against differences of `waves`, which computes the throw itself."""
    law = arrival_law.ArrivalLaw(
        (0.1, 0.05, 0.02, 0.01, -0.02, 0.01), (np.log(0.004), 0.3, 0.1, 0.02, 0.03, -0.02), (0.04, 0.04, 0.001),
        (0.002, 0.001, -0.001, 5e-4, 2e-4, 1e-4), 1e-3,
    )  # fmt: skip
    model, where = pulses(arrival=law, indexed=indexed), (rpm * RPM, float(np.deg2rad(angle_deg)))
    moved = np.array([0.03, 0.2, -0.02, 0.1, -0.2, 0.05, 0.01, 0.3, 0.02, -0.03])
    theta = model.start(flow_kg_s / 1100.0) + moved
    at, size = linear(model, theta, where), np.abs(model.waves(theta, *where)).max()
    assert np.abs(at.waves - model.waves(theta, *where)).max() < 2e-4 * size
    for i, step in enumerate(np.diag(np.full(theta.size, 1e-4))):
        expected = (model.waves(theta + step, *where) - model.waves(theta - step, *where)) / 2e-4
        assert np.abs(at.jacobian[:, i] - expected).max() < 0.02 * np.abs(expected).max()


def test_fits_side_by_side_are_those_of_each_alone() -> None:
    """Forty windows of two speeds and angles, some hard to fit, one above a full paddle."""
    model, rng = pulses(), np.random.default_rng(7)
    waves, near = [], []
    for number in range(40):
        where = (SPEED * (1.0 + 0.02 * (number % 2)), HOME - 0.1 * (number % 3 == 0))
        theta = model.start(rng.uniform(2.0, 20.0) / 1100.0, shift_s=rng.uniform(0.0, 0.16), log_gain=rng.normal(0.0, 0.3))
        at = linear(model, theta, where)
        off = 0.05 * np.abs(at.waves).max() * (rng.standard_normal((2, at.waves.size)) * (1 + 5 * (number % 7 == 0)))
        waves.append(PatternWave(at.waves + off[0] + 1j * off[1], noise(model), rng.uniform(3.0, 7.0), *where))
        near.append(float(np.exp(theta[0])) * (50.0 if number == 11 else 1.3))
    together = pulse_shape.estimate_near(model, waves, near)
    for number, (found, wave, flow) in enumerate(zip(together, waves, near, strict=True)):
        (alone,) = pulse_shape.estimate_near(pulses(), [wave], [flow])
        for key in ("volume_flow_m3_s", "relative_sd", "random_sd", "misfit", "relative_residual"):
            assert getattr(found, key) == pytest.approx(getattr(alone, key), rel=1e-9, nan_ok=True), (number, key)
        assert found.converged == alone.converged
        assert found.covariance == pytest.approx(alone.covariance, rel=1e-7, abs=1e-12, nan_ok=True)
        assert np.isnan(found.volume_flow_m3_s) == (number == 11)


@pytest.mark.parametrize("flow_kg_s", [4.0, 9.0, 18.0])
@pytest.mark.parametrize("beside", [0.7, 1.0, 1.4])
def test_a_fit_begun_near_the_flow_ends_where_one_begun_by_a_search_does(flow_kg_s: float, beside: float) -> None:
    model = pulses(sd={**PulseSettings().sd, "log_volume_flow": 10.0})
    theta = model.start(flow_kg_s / 1100.0, shift_s=0.11, log_gain=-0.4)
    theta[1:3] += 0.1, -0.02
    at = linear(model, theta, (SPEED, HOME))
    wave = PatternWave(at.waves * (1.0 + 0.01j), noise(model), 6.0, SPEED, HOME)
    (near,), searched = pulse_shape.estimate_near(model, [wave], [beside * flow_kg_s / 1100.0]), pulse_shape.estimate(model, wave)
    assert near.converged
    assert abs(np.log(near.volume_flow_m3_s / searched.volume_flow_m3_s)) < 0.1 * searched.relative_sd
    assert near.misfit == pytest.approx(searched.misfit, rel=0.1, abs=0.01)


def test_what_was_looked_at_before_changes_no_estimate() -> None:
    where, fresh, used = (SPEED, HOME), pulses(), pulses()
    for flow in np.geomspace(2.0, 20.0, 7):
        linear(used, used.start(flow / 1100.0), where)
    theta = fresh.start(8.0 / 1100.0)
    assert np.array_equal(linear(used, theta, where).jacobian, linear(fresh, theta, where).jacobian)


@pytest.mark.parametrize(("flow_kg_s", "angle_deg", "rpm"), [(8.0, 70.0, 400.0), (18.0, 90.0, 450.0)])
def test_scatter_of_the_estimate_is_what_fisher_information_says(flow_kg_s: float, angle_deg: float, rpm: float) -> None:
    model = pulses()
    rng = np.random.default_rng(20261122)
    where = (rpm * RPM, np.deg2rad(angle_deg))
    centre = model.start(flow_kg_s / 1100.0, shift_s=0.03)
    expected, _ = pulse_fit.information(
        model, centre, elevator_speed_rad_s=where[0], plate_angle_rad=where[1], noise_n=noise(model), patterns=6.0
    )
    drawn = model.prior_sd(6.0)
    drawn[[0, 6, 7]] = 0.0
    errors = []
    for _ in range(90):
        theta = centre + drawn * rng.standard_normal(drawn.size)
        at = linear(model, theta, where)
        sd = np.sqrt(noise(model) ** 2 + model.lasting_variance(at.envelope))
        shown = at.waves + sd * (rng.standard_normal(sd.size) + 1j * rng.standard_normal(sd.size))
        found = pulse_shape.estimate(model, PatternWave(shown, noise(model), 6.0, *where))
        errors.append(np.log(found.volume_flow_m3_s) - theta[0])
    assert np.std(errors) == pytest.approx(np.sqrt(expected[0, 0]), rel=0.2)


def test_more_of_the_same_window_does_not_wear_down_the_model_s_error() -> None:
    model = pulses()
    theta = model.start(8.0 / 1100.0)
    one, part = pulse_fit.information(
        model, theta, elevator_speed_rad_s=SPEED, plate_angle_rad=HOME, noise_n=noise(model), patterns=6.0
    )
    many, rest = pulse_fit.information(
        model, theta, elevator_speed_rad_s=SPEED, plate_angle_rad=HOME, noise_n=noise(model) / 10.0, patterns=600.0
    )
    assert rest[0, 0] < 0.1 * part[0, 0]
    assert many[0, 0] > 0.3 * one[0, 0]


def test_a_calibrated_arrival_law_is_found_again() -> None:
    true = arrival_law.ArrivalLaw((0.2, 0.05, 0.0, 0.0, 0.0, 0.0), (np.log(0.005), 0.3, 0.0, 0.0, 0.0, 0.0), (1e-4, 1e-2, 0.0))
    truth = pulses(arrival=true, model_error=0.005)
    flows = np.array([3.0, 6.0, 10.0, 14.0, 18.0]) / 1100.0
    waves = [
        PatternWave(truth.waves(truth.start(flow, shift_s=0.02), SPEED, HOME), 1e-3 * np.ones(24), 1e4, SPEED, HOME)
        for flow in flows
    ]
    law = calibrate_arrival(pulses(model_error=0.005), waves, flows.tolist(), terms=2)
    fills, at_home = np.array([0.2, 0.5]), law.conditions(HOME, SPEED, GRAIN["friction"])
    assert law.log_stretch(fills, at_home) == pytest.approx(true.log_stretch(fills, at_home), abs=0.02)
    assert law.tail_s(fills, at_home) == pytest.approx(true.tail_s(fills, at_home), rel=0.05)
    for flow, said in ((5.0, ""), (1.5, "load 0.02 of a full paddle, calibrated 0.04 to 0.25"), (10.0, "")):
        wave = PatternWave(
            truth.waves(truth.start(flow / 1100.0, shift_s=0.02), SPEED, HOME), 1e-3 * np.ones(24), 1e4, SPEED, HOME
        )
        assert pulse_shape.estimate(pulses(arrival=law), wave).outside == said
    assert law.outside(0.2, np.deg2rad(50.0), SPEED) == "plate at 50 deg, calibrated 70 to 70 deg"
    assert law.outside(0.2, HOME, 330.0 * RPM) == "elevator at 330 rpm, calibrated 400 to 400 rpm"
    assert not law.outside(0.2, HOME, 370.0 * RPM)
    with pytest.raises(ValueError, match="2 waves, expected more than 2"):
        calibrate_arrival(pulses(), waves[:2], flows[:2].tolist(), terms=2)


def test_a_law_over_several_grains_and_speeds_holds_for_another() -> None:
    """Stretch that depends on speed and friction is found again where neither was calibrated, and not by a law without them."""
    true = arrival_law.ArrivalLaw((0.15, 0.05, *(0.0,) * 6, 0.3, -0.2), (np.log(0.005), 0.3), (1e-4, 1e-2, 0.0))
    models, waves, flows = [], [], []
    for rpm, friction in itertools.product((360.0, 440.0), (0.15, 0.3)):
        grain = {**GRAIN, "friction": friction}
        truth = PulseModel(MODEL, grain, PulseSettings(arrival=true, model_error=0.005))
        for flow in np.array([3.0, 8.0, 15.0]) / 1100.0:
            shown = truth.waves(truth.start(flow, shift_s=0.02), rpm * RPM, HOME)
            waves.append(PatternWave(shown, 1e-3 * np.ones(24), 1e4, rpm * RPM, HOME))
            models.append(PulseModel(MODEL, grain, PulseSettings(model_error=0.005)))
            flows.append(float(flow))
    where = true.conditions(HOME, 400.0 * RPM, 0.2)
    fills = np.array([0.2, 0.5])
    several = (0, 1, 8, 9)
    law = calibrate_arrival(models, waves, flows, terms=(several, several, several))
    assert law.log_stretch(fills, where) == pytest.approx(true.log_stretch(fills, where), abs=0.02)
    assert law.log_stretch(fills, true.conditions(HOME, 440.0 * RPM, 0.15)) == pytest.approx(
        true.log_stretch(fills, true.conditions(HOME, 440.0 * RPM, 0.15)), abs=0.02
    )
    assert law.covariance[0] < 0.1 * calibrate_arrival(models, waves, flows, terms=2).covariance[0]


def test_folding_keeps_the_harmonics_and_leaves_the_noise() -> None:
    rng = np.random.default_rng(7)
    phase = np.arange(6000) * 6.083e-3 + 0.2
    wave = 40.0 + 30.0 * np.cos(2.0 * np.pi * 2.0 * phase - 0.5) + 5.0 * np.cos(2.0 * np.pi * 9.0 * phase + 1.0)
    shown = wave + 1.5 * rng.standard_normal(phase.size)
    folded = fold(shown, phase)
    found = harmonics_of(folded, 12, elevator_speed_rad_s=SPEED, plate_angle_rad=HOME)
    assert found.amplitudes_n[1] == pytest.approx(15.0 * np.exp(-0.5j), abs=0.1)
    assert found.amplitudes_n[8] == pytest.approx(2.5 * np.exp(1.0j), abs=0.1)
    assert np.abs(found.amplitudes_n[4]) < 5.0 * found.noise_n[4]
    assert np.std(residual(shown, phase, folded)) == pytest.approx(1.5, rel=0.1)
    with pytest.raises(ValueError, match="bins without samples"):
        harmonics_of(fold(shown[:20], phase[:20]), 12, elevator_speed_rad_s=SPEED, plate_angle_rad=HOME)


@pytest.mark.parametrize("flow_kg_s", [6.0, 10.0, 16.0])
def test_the_contrast_of_two_loads_gives_the_volume_flow(flow_kg_s: float) -> None:
    where = {"plate_angle_rad": HOME, "elevator_speed_rad_s": SPEED}
    gaps = np.array(MACHINE.paddle_spacings_m)
    speed = MACHINE.paddle_speed_m_s(SPEED)
    impulses = np.array([throw(MACHINE, Grain(), Effects(), flow_kg_s * g / speed, HOME, SPEED).impulse_n_s.sum() for g in gaps])
    found = contrast(impulses, gaps, impulse_sd=np.array([1e-3, 1e-3]))
    assert found.exponent == pytest.approx(expected_exponent(MODEL, GRAIN, np.array([flow_kg_s / 1100.0]), **where)[0], abs=0.01)
    flow = flow_of(found, MODEL, GRAIN, **where)
    assert flow.volume_flow_m3_s == pytest.approx(flow_kg_s / 1100.0, rel=0.06)
    assert 0.0 < flow.relative_sd < 0.2
    with pytest.raises(ValueError, match="expected two that differ"):
        contrast(impulses, np.array([0.18, 0.18]), impulse_sd=np.array([1e-3, 1e-3]))


@pytest.mark.parametrize(
    ("late_turns", "spread", "wider"), [(0.0, 0.0, 0.0), (0.004, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.05), (0.004, 0.1, 0.05)]
)
def test_pulses_that_creep_and_differ_leave_only_their_noise(late_turns: float, spread: float, wider: float) -> None:
    """Two pulses a pattern, each with a size, a time and a width of its own, and white noise of 1 N."""
    rng, spacings = np.random.default_rng(3), (0.1656, 0.2071)
    edges = np.concatenate(([0.0], np.cumsum(spacings) / np.sum(spacings)))
    phase = np.arange(6000) * 6.08e-3 + 0.3

    def force(turns: np.ndarray, sizes: np.ndarray, late: np.ndarray, widths: np.ndarray) -> np.ndarray:
        total = np.zeros_like(turns)
        for number, (turn, edge) in enumerate(itertools.product(range(-1, 40), edges[:2])):
            away = (turns - turn - edge - late[number]) / (0.05 * widths[number])
            total += 100.0 * sizes[number] * np.exp(-0.5 * away**2)
        return total

    noise, drawn = rng.standard_normal(phase.size), rng.standard_normal((3, 82))
    shown = force(phase, 1.0 + spread * drawn[0], late_turns * drawn[1], 1.0 + wider * drawn[2]) + noise
    fine = 5.0 + (np.arange(512) + 0.5) / 512
    mean = FoldedPattern(force(fine, np.ones(82), np.zeros(82), np.ones(82)), np.zeros(512), np.full(512, 100.0), 100.0)
    plain, (own, late) = residual(shown, phase, mean), residuals_of_pulses([shown], [phase], [mean], spacings)[0]
    if late_turns > 0.0:
        # The first pulse that the samples hold as a whole is the fifth of those that were made.
        assert np.corrcoef(late, drawn[1][4 : 4 + late.size])[0, 1] > 0.99
        assert np.std(late) == pytest.approx(late_turns * np.std(drawn[1]), rel=0.15)
    assert np.std(own) == pytest.approx(np.std(noise), rel=0.06)
    assert bool(np.std(plain) > 1.5 * np.std(noise)) is (late_turns > 0.0 or spread > 0.0 or wider > 0.0)


@pytest.mark.parametrize("spacings", [(0.19,), (0.1656, 0.2071), (0.15, 0.2, 0.18)])
def test_windows_side_by_side_leave_what_each_leaves_alone(spacings: tuple[float, ...]) -> None:
    """Windows of other lengths and speeds, down to fewer samples than a pulse has."""
    rng = np.random.default_rng(11)
    lengths = (1003, 997, 40, 5, 1000)
    phases = [rng.uniform(0.0, 5.0) + rng.uniform(3e-3, 9e-3) * np.arange(length) for length in lengths]
    samples = [50.0 + 20.0 * rng.standard_normal(length) for length in lengths]
    pulses = 50.0 * np.exp(-(((np.arange(512) % 200 - 60) / 30.0) ** 2))
    means = [FoldedPattern(pulses + rng.standard_normal(512), np.zeros(512), np.ones(512), 9.0) for _ in lengths]
    together = residuals_of_pulses(samples, phases, means, spacings)
    for number, (left, late) in enumerate(together):
        ((alone, late_alone),) = residuals_of_pulses([samples[number]], [phases[number]], [means[number]], spacings)
        assert left.tobytes() == alone.tobytes()
        assert late.tobytes() == late_alone.tobytes()
        assert left.size == lengths[number]
    assert together[0][1].size >= 2


def test_a_law_is_the_sum_of_its_terms_and_every_two_of_load_cosine_speed_and_friction_have_one() -> None:
    """In the range of its loads; so are its slopes, which the fits take."""
    rng = np.random.default_rng(3)
    coefficients, fill = tuple(rng.normal(size=arrival_law.TERMS)), 0.2
    where = tuple(np.array(v) for v in (0.4, 0.2, -0.7))
    value, slope = arrival_law.law_and_slope(coefficients, np.array(fill), where)
    assert float(value) == pytest.approx(float(arrival_law.features(fill, where) @ coefficients))
    further = [float(arrival_law.features(fill * np.exp(step), where) @ coefficients) for step in (1e-5, -1e-5)]
    assert float(slope) == pytest.approx((further[0] - further[1]) / 2e-5, rel=1e-6)
    x, c, r, p = np.log(fill), *(float(v) for v in where)
    found = arrival_law.features(fill, where)
    assert all(np.isclose(found, both).any() for both in (x * c, x * r, x * p, c * r, c * p, r * p))
