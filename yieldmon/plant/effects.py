"""What a real machine does beyond the bare throw: each effect switched on by being present.

The forms are the virtual combine's own; they share names with the effects that the monitor knows, not formulas.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from yieldmon.strict_model import StrictModel


class Gravity(StrictModel):
    """Weight of the grain on the paddle and in flight."""

    acceleration_m_s2: Annotated[float, Field(gt=0, le=20)] = 9.81


class AirDrag(StrictModel):
    """Deceleration g (v / terminal speed)^exponent against the velocity; the exponent is below 2 in a loose stream."""

    terminal_speed_m_s: Annotated[float, Field(ge=3, le=60)] = 11.0
    exponent: Annotated[float, Field(ge=1, le=2)] = 1.8


class JetShielding(StrictModel):
    """Grain strikes grain: restitution falls with the stream's thickness T as 1 / (1 + (T / thickness)^2).

    T is the depth of stream (m, at bulk density) that passes the plate at a parcel's place in the pulse.
    """

    thickness_m: Annotated[float, Field(gt=0, le=1)] = 0.02


class PlateFriction(StrictModel):
    """Tangential impulse on the plate: Coulomb, up to the share of tangential speed that brings a sphere to rolling."""

    friction: Annotated[float, Field(ge=0, le=1)] = 0.2
    rolling_share: Annotated[float, Field(gt=0, le=1)] = 2.0 / 7.0


class ResidualRadialSpeed(StrictModel):
    """Grain already moves outward when its paddle points up; share of the tip speed at the tip, growing with radius."""

    share_of_tip_speed: Annotated[float, Field(ge=0, le=1)] = 0.1


class ReleaseAngle(StrictModel):
    """The housing lets the grain go when the paddle stands this far past (+) or before (-) vertical."""

    angle_deg: Annotated[float, Field(ge=-30, le=30)] = 5.0


class StreamSpread(StrictModel):
    """Half width of the fan into which the layers of the heap leave the tip, outermost layer downward."""

    half_width_deg: Annotated[float, Field(ge=0, le=30)] = 5.0


class SpeedDependentShape(StrictModel):
    """Relative change of the shape ratio per relative change of elevator speed from nominal."""

    exponent: Annotated[float, Field(ge=-3, le=3)] = -0.5


class SpeedDependentFriction(StrictModel):
    """Friction on the paddle falls from standstill to fast sliding: grain friction times 1 + rise exp(-v / speed).

    v is the speed along the paddle; a rise below 0 makes it grow instead.
    """

    rise: Annotated[float, Field(ge=-1, le=10)] = 1.0
    speed_m_s: Annotated[float, Field(gt=0, le=20)] = 1.5


class MissCapture(StrictModel):
    """Share of the grain that passes below the plate's low edge and is led back onto it by the housing."""

    captured_share: Annotated[float, Field(ge=0, le=1)] = 0.5
    over_top_share: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Share of the grain above the plate's top edge that the housing's roof leads onto the plate."""


class SpeedDependentRestitution(StrictModel):
    """Restitution falls as (normal speed / reference speed)^-exponent; 1/4 for plastic contact."""

    reference_speed_m_s: Annotated[float, Field(gt=0, le=20)] = 6.0
    exponent: Annotated[float, Field(ge=0, le=1)] = 0.25


class SecondaryImpact(StrictModel):
    """Share of the rebounding grain that strikes the plate once more with the speed it left with."""

    share: Annotated[float, Field(ge=0, le=1)] = 0.2


class RestingGrain(StrictModel):
    """Time that grain lies on the plate before it slides off; its weight presses on the plate meanwhile."""

    time_s: Annotated[float, Field(ge=0, le=2)] = 0.1


class PaddleLeakage(StrictModel):
    """Share of a load that drops past the plate straight to the tank: grows with fill, falls with elevator speed."""

    share_at_full: Annotated[float, Field(ge=0, le=0.9)] = 0.2
    fill_exponent: Annotated[float, Field(ge=0, le=4)] = 1.0


class ChainSlip(StrictModel):
    """Share by which paddles run slower than the speed frame says."""

    share: Annotated[float, Field(ge=-0.2, le=0.5)] = 0.03


class PaddleWear(StrictModel):
    """Length lost at the tip."""

    length_mm: Annotated[float, Field(ge=0, le=60)] = 5.0


class ZeroOffset(StrictModel):
    """Constant force that appears with grain only, so that no zeroing while empty takes it away."""

    force_n: Annotated[float, Field(ge=-100, le=100)] = 2.0


class PlateAngleOffset(StrictModel):
    """True plate angle minus the angle in the feedback frame."""

    angle_deg: Annotated[float, Field(ge=-8, le=8)] = 2.0


class LeverArm(StrictModel):
    """The cell weighs an impact by its place: 1 + slope (distance from the plate's middle / plate length), down +."""

    slope: Annotated[float, Field(ge=-2, le=2)] = 0.3


class CellNonlinearity(StrictModel):
    """Force shown = F (1 - share F / full-scale force)."""

    share: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.1


class PlateBuildup(StrictModel):
    """Mass stuck to the plate: its weight presses on the plate as far as the plate lies flat."""

    mass_kg: Annotated[float, Field(ge=0, le=5)] = 0.3


class MoistureDependence(StrictModel):
    """Relative change of each property per point of moisture away from the grain's own."""

    friction_per_pct: Annotated[float, Field(ge=-0.2, le=0.2)] = 0.03
    restitution_per_pct: Annotated[float, Field(ge=-0.1, le=0.1)] = -0.015
    density_per_pct: Annotated[float, Field(ge=-0.05, le=0.05)] = -0.004


def _switched(value: Any) -> Any:
    if value is True or value == "on":
        return {}
    return None if value is False or value == "off" else value


class Effects(StrictModel):
    """Effects in force; None is off. In YAML: ``air_drag: {terminal_speed_m_s: 9}``, ``air_drag: on``, ``gravity: off``."""

    gravity: Gravity | None = Gravity()
    air_drag: AirDrag | None = None
    jet_shielding: JetShielding | None = None
    plate_friction: PlateFriction | None = None
    residual_radial_speed: ResidualRadialSpeed | None = None
    release_angle: ReleaseAngle | None = None
    stream_spread: StreamSpread | None = None
    speed_dependent_shape: SpeedDependentShape | None = None
    speed_dependent_friction: SpeedDependentFriction | None = None
    miss_capture: MissCapture | None = None
    speed_dependent_restitution: SpeedDependentRestitution | None = None
    secondary_impact: SecondaryImpact | None = None
    resting_grain: RestingGrain | None = None
    paddle_leakage: PaddleLeakage | None = None
    chain_slip: ChainSlip | None = None
    paddle_wear: PaddleWear | None = None
    zero_offset: ZeroOffset | None = None
    plate_angle_offset: PlateAngleOffset | None = None
    lever_arm: LeverArm | None = None
    cell_nonlinearity: CellNonlinearity | None = None
    plate_buildup: PlateBuildup | None = None
    moisture_dependence: MoistureDependence | None = None

    @model_validator(mode="before")
    @classmethod
    def _switches(cls, values: Any) -> Any:
        """``on`` takes an effect's defaults, ``off`` leaves it out."""
        if not isinstance(values, dict):
            return values
        return {name: _switched(value) for name, value in values.items()}

    @property
    def gravity_m_s2(self) -> float:
        """Acceleration of gravity in force, m/s2; 0 when switched off."""
        return self.gravity.acceleration_m_s2 if self.gravity else 0.0
