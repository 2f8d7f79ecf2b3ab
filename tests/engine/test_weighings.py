"""Which weighed loads go on after a restart, and which are forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.engine.self_calibration.weighings import Weighings
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad


def load(name: str) -> WeighedLoad:
    one = np.ones(3)
    return WeighedLoad(name, 100.0, 1.0, one, 50.0 * one, one, 40.0 * one)


@pytest.mark.parametrize(
    ("names", "counted", "doubted"),
    [
        ((), ["1", "2"], "3"),
        (("3",), ["1", "2"], ""),
        (("1",), ["2"], "3"),
        (("1", "3", "9"), ["2"], ""),
        (("1", "2", "3"), [], ""),
    ],
)
def test_loads_that_were_weighed_otherwise_are_forgotten(names: tuple[str, ...], counted: list[str], doubted: str) -> None:
    weighings = Weighings(LoadSettings())
    assert (weighings.counted, weighings.doubted_name) == ((), "")
    weighings.restore([load("1"), load("2")], load("3"))
    weighings.forget(names)
    assert ([known.name for known in weighings.counted], weighings.doubted_name) == (counted, doubted)
    weighings.restore([load("7")], None)
    assert ([known.name for known in weighings.counted], weighings.doubted_name) == (["7"], "")
    weighings.forget({"7"})
    assert weighings.counted == ()
