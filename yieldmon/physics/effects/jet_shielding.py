"""Grain that strikes grain instead of the plate in a thick stream."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics import settling
from yieldmon.physics.numerics import exp
from yieldmon.physics.stages import Impulse, Setting

from .effect import Effect, EffectParameter, Values, where_restitution
from .rebound import scale_restitution


def _impulse(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    jet = impulse.arrival.jet
    angle = settling.opening_angle(jet.release_radius, jet.inner_radius, setting.shape_ratio)
    thickness_m = angle * jet.release_radius * setting.paddle_length_m
    factor = 1.0 / (1.0 + values["rate_per_m"] * thickness_m)
    return replace(impulse, normal_gain=scale_restitution(impulse, factor, setting))


def _by_fill(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    fill = impulse.arrival.jet.load.paddle_mass_kg / setting.full_paddle_mass_kg
    return replace(impulse, normal_gain=scale_restitution(impulse, 1.0 / (1.0 + values["rate"] * fill), setting))


def _free_path(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    fill = impulse.arrival.jet.load.paddle_mass_kg / setting.full_paddle_mass_kg
    return replace(impulse, normal_gain=scale_restitution(impulse, exp(-values["rate"] * fill), setting))


@where_restitution
def _in_part(impulse: Impulse, values: Values, setting: Setting) -> Impulse:
    jet = impulse.arrival.jet
    angle = settling.opening_angle(jet.release_radius, jet.inner_radius, setting.shape_ratio)
    thickness_m = angle * jet.release_radius * setting.paddle_length_m
    lost = values["most"] * (1.0 - exp(-thickness_m / values["depth_m"]))
    return replace(impulse, normal_gain=scale_restitution(impulse, 1.0 - lost, setting))


EFFECT = Effect(
    name="jet_shielding",
    stage="impact",
    of_grain=True,
    summary="Rebound dies in a thick stream, because grain rebounds into the grain behind it.",
    signature="sublinear over load from the first kernels on: gain from 1 + e for a thin stream to 1 for a thick one",
    source="inelastic landing of dense granular jets: Cheng et al., Physical Review Letters 99, 188001 (2007)",
    parameters=(EffectParameter("rate_per_m", "1/m", 0.0, 0.0, 300.0, 20.0, "1 / stream thickness that halves rebound", 20.0),),
    impulse=_impulse,
)

LAWS = (
    replace(
        EFFECT,
        name="jet_shielding-by_fill",
        law="by the fill of the paddle instead of the thickness of each layer",
        source="the stream as one body, its thickness in proportion to the load",
        parameters=(EffectParameter("rate", "", 0.0, 0.0, 20.0, 1.0, "1 / fill that halves rebound", 1.5),),
        impulse=_by_fill,
    ),
    replace(
        EFFECT,
        name="jet_shielding-free_path",
        law="the share of grain that rebounds through the stream without meeting any, exponential in the fill of the paddle",
        source="free path in a gas of grains: the chance to meet none of a mean number of n is exp(-n)",
        parameters=(EffectParameter("rate", "", 0.0, 0.0, 20.0, 1.0, "grains met on the way out, per fill", 1.5),),
        impulse=_free_path,
    ),
    replace(
        EFFECT,
        name="jet_shielding-in_part",
        law="a thick stream keeps a part of its rebound; where the impact's gain is 1 + restitution",
        source="a dense layer rebounds as a body, with a restitution of its own",
        parameters=(
            EffectParameter("most", "", 0.0, 0.0, 1.0, 0.3, "share of the rebound that a thick stream loses", 0.4),
            EffectParameter("depth_m", "m", 0.03, 0.003, 0.3, 0.05, "thickness that loses 1 - 1/e of that share", 0.06),
        ),
        impulse=_in_part,
    ),
)
