"""Hidden plate friction, and what is stated of a load that closed before the plate first left home."""

from studies.coverage.__main__ import CASES, Case, Sizes, one


def test_a_load_before_the_first_sweep_is_covered_once_the_sweep_has_shown_the_error() -> None:
    (sweeps,) = [case for case in CASES if case.name == "sweeps"]
    found = one(sweeps, 130.0, 41999, fixed=True)
    assert found.load[0] > 4.0, "as it closed, it knows nothing of the friction"
    assert abs(found.load_posted[0]) < 2.0


def test_an_error_so_large_that_it_ends_every_sweep_is_seen_when_the_plate_is_home_again() -> None:
    large = Sizes(plate_friction=0.33, sweep_every_s=30.0, swings=False)
    found = one(Case("large", lambda rng: large, large), 130.0, 41999, fixed=True)
    assert abs(found.load_posted[0]) < 2.0
