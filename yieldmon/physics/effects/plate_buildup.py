"""Crop stuck to the plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.stages import Reading, Setting

from .effect import Effect, EffectParameter, Values, where_restitution, with_force


def _reading(reading: Reading, values: Values, setting: Setting) -> Reading:
    force = values["weight_n"] * np.cos(setting.plate_angle_rad)
    return with_force(reading, force, setting)


def _zeroed(reading: Reading, values: Values, setting: Setting) -> Reading:
    angle, home = setting.plate_angle_rad, setting.machine.home_plate_angle_rad
    force = values["weight_n"] * (np.sin(angle) * np.cos(angle) - np.sin(home) * np.cos(home))
    return with_force(reading, force, setting)


@where_restitution
def _zeroed_across(reading: Reading, values: Values, setting: Setting) -> Reading:
    force = values["weight_n"] * (np.cos(setting.plate_angle_rad) - np.cos(setting.machine.home_plate_angle_rad))
    return with_force(reading, force, setting)


EFFECT = Effect(
    name="plate_buildup",
    stage="sensor",
    summary="Material stuck to the plate loads the cell as far as the plate lies flat.",
    signature="a force without grain that goes as cos(phi), the same at every flow",
    source="statics: component of the weight across the plate",
    parameters=(EffectParameter("weight_n", "N", 0.0, 0.0, 30.0, 2.0, "weight of what sticks", 4.0),),
    reading=_reading,
    unit_follows_response=True,
)

LAWS = (
    replace(
        EFFECT,
        name="plate_buildup-zeroed",
        law="the horizontal part of the weight across the plate, less what the zero at home took away",
        source="statics: W cos(phi) across the plate, sin(phi) of that horizontal; zero taken at home with what sticks there",
        reading=_zeroed,
    ),
    replace(
        EFFECT,
        name="plate_buildup-zeroed_across",
        law="the weight across the plate, less what the zero at home took away; where the impact's gain is 1 + restitution",
        source="statics: W cos(phi) across the plate; zero taken at home with what sticks there",
        reading=_zeroed_across,
    ),
)
