"""What a parcel gives to the plate: its horizontal impulse, N s per kg."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array
from yieldmon.plant.effects import Effects
from yieldmon.plant.flight import Arrival


def landed_share(arrival: Arrival, plate_length_m: float, effects: Effects) -> Array:
    """Share of each parcel that strikes the plate; parcels are along the second last axis.

    A parcel is as long as the distance between the places where its neighbours land, so the share runs smoothly from 1 to 0.
    Above the top edge the housing's roof leads grain onto the plate unless miss_capture says otherwise.
    """
    place = arrival.below_edge_m
    extent = np.maximum(np.abs(np.gradient(place, axis=-2)), 1e-9)
    share = np.clip(0.5 - place / extent, 0.0, 1.0)
    capture = effects.miss_capture
    if capture is not None:
        over = np.clip(0.5 - (place + plate_length_m) / extent, 0.0, 1.0)
        share = share + capture.captured_share * (1.0 - share) - over * (1.0 - capture.over_top_share)
    return np.where(np.isfinite(place), np.nan_to_num(share), 0.0)


def restitution(arrival: Arrival, stream_depth_m: Array, grain_restitution: float, effects: Effects) -> Array:
    """Coefficient of restitution of each parcel after the effects of speed and of the stream's depth."""
    e = np.full_like(arrival.normal_speed_m_s, grain_restitution)
    if (law := effects.speed_dependent_restitution) is not None:
        e = e * (arrival.normal_speed_m_s / law.reference_speed_m_s) ** -law.exponent
    if (shield := effects.jet_shielding) is not None:
        e = e / (1.0 + (stream_depth_m / shield.thickness_m) ** 2)
    return np.minimum(e, 1.0)


def horizontal_impulse(arrival: Arrival, e: Array, plate_angle_rad: Array, plate_length_m: float, effects: Effects) -> Array:
    """Horizontal impulse per kg that lands, as the cell feels it, m/s."""
    normal = (1.0 + e) * arrival.normal_speed_m_s
    if (second := effects.secondary_impact) is not None:
        normal = normal + second.share * (1.0 + e) * e * arrival.normal_speed_m_s
    impulse = normal * np.sin(plate_angle_rad)
    if (rub := effects.plate_friction) is not None:
        limit = rub.rolling_share * np.abs(arrival.tangential_speed_m_s)
        along = np.minimum(rub.friction * normal, limit) * np.sign(arrival.tangential_speed_m_s)
        impulse = impulse + along * np.cos(plate_angle_rad)
    if (rest := effects.resting_grain) is not None:
        weight = effects.gravity_m_s2 * np.cos(plate_angle_rad) * np.sin(plate_angle_rad)
        impulse = impulse + weight * rest.time_s
    if (lever := effects.lever_arm) is not None:
        middle = arrival.below_edge_m + 0.5 * plate_length_m
        impulse = impulse * (1.0 + lever.slope * np.clip(middle / plate_length_m, -0.5, 0.5))
    return impulse
