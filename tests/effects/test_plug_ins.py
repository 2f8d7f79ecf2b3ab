"""Effects of other packages: what cannot be fitted is refused with what is wrong about it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from yieldmon.errors import InputError
from yieldmon.physics.effect_check import check
from yieldmon.physics.effects import Effect, EffectParameter, registry

LOSS = EffectParameter("loss", "", 0.0, 0.0, 0.5, 0.1, "share that is lost", 0.1)


def scaled(factor: Callable[[Any], Any]) -> Effect:
    return Effect(
        "damp", "impact", "s", "g", "x", (LOSS,),
        impulse=lambda impulse, values, setting: replace(impulse, weight=impulse.weight * factor(values["loss"])),
    )  # fmt: skip


SOUND = scaled(lambda loss: 1.0 - loss)
UNSOUND = {
    "has the name 'a b'": replace(SOUND, name="a b"),
    "has the stage 'plate'": replace(SOUND, stage="plate"),
    "has no parameters, or two of one name": replace(SOUND, parameters=(LOSS, LOSS)),
    "has a parameter 'lo-ss'": replace(SOUND, parameters=(replace(LOSS, name="lo-ss"),)),
    "loss has null 0, typical 0.1, bounds 0.5 to 0.1": replace(SOUND, parameters=(replace(LOSS, lower=0.5, upper=0.1),)),
    "loss has prior_sd 0": replace(SOUND, parameters=(replace(LOSS, prior_sd=0.0),)),
    "changes nothing": replace(SOUND, impulse=None),
    "fails with KeyError": replace(SOUND, parameters=(replace(LOSS, name="share"),)),
    "fails with TypeError": scaled(math.exp),
    "gives no number": scaled(lambda loss: np.where(loss == 0.0, 1.0, np.nan)),
    "changes the force at loss 0, its null": scaled(lambda loss: 0.9 - loss),
    "loses the derivative by loss": scaled(lambda loss: 1.0 - np.abs(loss)),
}


def test_a_sound_one_is_taken() -> None:
    check(SOUND, "plug-in")


@pytest.mark.parametrize("name", ["gravity", "plate_friction", "jet_shielding", "chain_slip", "moisture_dependence"])
def test_the_package_s_own_would_be_taken(name: str) -> None:
    check(registry()[name], "plug-in")


@pytest.mark.parametrize("wrong", UNSOUND)
def test_an_unsound_one_is_refused(wrong: str) -> None:
    with pytest.raises(InputError, match=r"^plug-in: ") as caught:
        check(UNSOUND[wrong], "plug-in")
    assert str(caught.value).startswith(f"plug-in: {wrong}")
