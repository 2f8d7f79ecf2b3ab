"""Grain that falls back between paddle and housing on the way up."""

from __future__ import annotations

from dataclasses import replace

from yieldmon.physics.numerics import power
from yieldmon.physics.stages import Load, Setting

from .effect import Effect, EffectParameter, Values, where_restitution


def _load(load: Load, values: Values, setting: Setting) -> Load:
    fill = load.paddle_mass_kg / setting.full_paddle_mass_kg
    slowness = setting.machine.nominal_elevator_speed_rad_s / setting.elevator_speed_rad_s
    return replace(load, paddle_mass_kg=load.paddle_mass_kg / (1.0 + values["loss_at_full"] * fill * slowness))


def _any_speed(load: Load, values: Values, setting: Setting) -> Load:
    fill = load.paddle_mass_kg / setting.full_paddle_mass_kg
    return replace(load, paddle_mass_kg=load.paddle_mass_kg / (1.0 + values["loss_at_full"] * fill))


def _overfull(load: Load, values: Values, setting: Setting) -> Load:
    fill = load.paddle_mass_kg / setting.full_paddle_mass_kg
    return replace(load, paddle_mass_kg=load.paddle_mass_kg / (1.0 + values["loss_at_full"] * fill * fill))


def _orifice(load: Load, values: Values, setting: Setting) -> Load:
    slowness = setting.machine.nominal_elevator_speed_rad_s / setting.elevator_speed_rad_s
    mass = load.paddle_mass_kg
    return replace(load, paddle_mass_kg=mass * mass / (mass + values["loss_kg"] * slowness + 1e-30))


@where_restitution
def _by_powers(load: Load, values: Values, setting: Setting) -> Load:
    fill = load.paddle_mass_kg / setting.full_paddle_mass_kg
    slowness = setting.machine.nominal_elevator_speed_rad_s / setting.elevator_speed_rad_s
    lost = values["loss_at_full"] * power(fill, values["fill_power"]) * power(slowness, values["time_power"])
    return replace(load, paddle_mass_kg=load.paddle_mass_kg / (1.0 + lost))


EFFECT = Effect(
    name="paddle_leakage",
    stage="fill",
    summary="Part of each load falls back past the paddle, the more the fuller the paddle and the slower the elevator.",
    signature="flow lost in proportion to fill and to 1/speed; the same at every plate angle for a given load",
    source="continuity: loss rate proportional to head over the gap, time on the way up proportional to 1/speed",
    parameters=(
        EffectParameter("loss_at_full", "", 0.0, 0.0, 1.0, 0.1, "mass lost over mass kept, per fill, at the nominal speed", 0.3),
    ),
    load=_load,
)

LAWS = (
    replace(
        EFFECT,
        name="paddle_leakage-any_speed",
        law="by fill alone, whatever the speed",
        source="what lies above the paddle's edge falls back at once",
        load=_any_speed,
    ),
    replace(
        EFFECT,
        name="paddle_leakage-overfull",
        law="by the square of fill, whatever the speed: little is lost until the paddle is well filled",
        source="height above the edge times width of the heap, each in proportion to fill",
        parameters=(EffectParameter("loss_at_full", "", 0.0, 0.0, 2.0, 0.1, "mass lost over mass kept, at full", 0.3),),
        load=_overfull,
    ),
    replace(
        EFFECT,
        name="paddle_leakage-orifice",
        law="one mass from each paddle, whatever its load, in proportion to the time on the way up; never more than there is",
        source="discharge of grain through an opening does not depend on the head: Beverloo, Leniger and van de Velde, Chemical "
        "Engineering Science 15 (1961)",
        parameters=(EffectParameter("loss_kg", "kg", 0.0, 0.0, 0.3, 0.03, "mass lost a paddle at the nominal speed", 0.05),),
        load=_orifice,
    ),
    replace(
        EFFECT,
        name="paddle_leakage-by_powers",
        law="by powers of fill and of the time on the way up, both free; where the impact's gain is 1 + restitution",
        source="discharge by a power of the head: 0 of grain (Beverloo, 1961), 1/2 of a liquid, 3/2 of one over a weir",
        parameters=(
            EffectParameter("loss_at_full", "", 0.0, 0.0, 2.0, 0.1, "mass lost over mass kept, at full and nominal speed", 0.3),
            EffectParameter("fill_power", "", 1.0, 0.0, 3.0, 0.5, "power of fill that the share lost goes with", 1.5),
            EffectParameter("time_power", "", 1.0, 0.0, 3.0, 0.5, "power of 1 / speed that it goes with", 1.5),
        ),
        load=_by_powers,
    ),
)
