"""The harvest gate on every combination of what it is shown, at its limits and beyond, from each state that it can be in."""

from __future__ import annotations

from itertools import product
from math import nan, nextafter

import pytest

from yieldmon.engine.mass.gates import GateInputs, HarvestGate
from yieldmon.engine.settings import GateSettings

SETTINGS = GateSettings(grain_on_n=1.0, grain_off_n=0.5, certain_force_n=10.0, off_windows=3, emptying_s=20.0)
FORCES_N = (nan, -2.0, 0.5, nextafter(0.5, 1.0), 1.0, nextafter(1.0, 2.0), 10.0, nextafter(10.0, 11.0))
GRAIN = GateInputs(60.0, pulses=True, looks_empty=False, looks_loaded=True, speed_in_range=True)
NONE = GateInputs(0.0, pulses=False, looks_empty=False, looks_loaded=False, speed_in_range=True)
CLOSED = None


def gate_after(without: int | None) -> HarvestGate:
    """A gate that is open and has since seen so many windows without grain; closed where that is CLOSED."""
    gate = HarvestGate(SETTINGS)
    if without is not CLOSED:
        gate.see(GRAIN)
        for _ in range(without):
            gate.see(NONE)
    return gate


def holds_grain(shown: GateInputs, *, is_open: bool) -> bool:
    if not shown.pulses and shown.looks_empty:
        return False
    if shown.force_n > 10.0:
        return True
    sign = is_open or shown.pulses or shown.looks_loaded
    return sign and shown.force_n > (0.5 if is_open else 1.0)


@pytest.mark.parametrize("without", [CLOSED, 0, 1, 2])
def test_any_window_in_any_state(without: int | None) -> None:
    yes_no = (False, True)
    for force_n, pulses, empty, loaded, in_range, idle_s in product(
        FORCES_N, yes_no, yes_no, yes_no, yes_no, (0.0, nextafter(20.0, 0.0), 20.0)
    ):
        shown, is_open = GateInputs(force_n, pulses, empty, loaded, in_range, idle_s), without is not CLOSED
        grain = holds_grain(shown, is_open=is_open)
        shut = not in_range or (idle_s >= 20.0 and not force_n > 10.0)
        gate = gate_after(without)
        assert gate.harvesting is is_open
        assert gate.grain(shown) is grain, shown
        stays = grain or (without is not CLOSED and without + 1 < 3)
        assert gate.see(shown) is (stays and not shut), shown
        # Windows without grain are counted from the last one with grain, or from where it opened anew.
        left = 0 if not gate.harvesting else 3 if grain else 3 - without - 1  # type: ignore[operator]
        assert [gate.see(NONE) for _ in range(3)] == [number < left for number in (1, 2, 3)], shown


def test_a_gate_that_was_shut_counts_anew() -> None:
    gate = gate_after(2)
    gate.see(GateInputs(60.0, pulses=True, looks_empty=False, looks_loaded=True, speed_in_range=False))
    assert [gate.see(shown) for shown in (GRAIN, NONE, NONE, NONE)] == [True, True, True, False]
