"""Time constant of plate and force cell, from taps on the plate.

A tap is short compared with the response of plate and cell, so the cell measures their impulse response. It is modelled as
critically damped, as for pulses and kernel noise (`physics.machine.ImpactSensor.response_s`):
F(t) = impulse (t - t0) / tau^2 exp(-(t - t0) / tau). Each tap is fitted separately (time constant and time by nonlinear least
squares, size and offset in closed form), so that the scatter between taps gives the uncertainty of the time constant.

Source: the response of a second-order system, e.g. Ogata, "Modern Control Engineering", 5th ed., section 5-3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from yieldmon.estimation.gaussian import SD_PER_MAD
from yieldmon.physics.machine import LONGEST_RESPONSE_S
from yieldmon.physics.numerics import Array

LEAST_TAPS = 5
_CLEAR = 20.0
"""Least height of a tap relative to the noise."""
_BEFORE_S, _AFTER_S = 0.03, 0.15
_APART_S = 0.3
_RINGING = 0.1
"""Largest rms residual of a fit relative to the tap's height; beyond it the response is not critically damped."""
_UNLIKE = 0.07
"""Largest rms residual beyond noise relative to the tap's own rms. Contacts of 2 ms and samples that are averages leave up to
0.03; a damping of 0.8, or a cell of first order of three samples or more, at least 0.08."""
_LASTS = 12.0
"""Time constants after which nothing of a tap is left."""
_OUTLIER_SDS, _LEAST_SPREAD = 4.0, 0.01
_CONTACT_SD_S = 4.6e-4
"""Standard deviation of time within a force of 2 ms, about the longest contact of a tap."""
_CUT_OFF = "cut off by a gap in the samples or the log's end"
_LEFT_OUT = ("beyond the sensor's range", "too close to another", _CUT_OFF, "unlike the others")


@dataclass(frozen=True)
class TapResponse:
    """Result of `tap_response`.

    Attributes
    ----------
    response_s, std_dev_s : float
        Time constant and its standard deviation from the taps' scatter and the possible duration of a contact.
    each_s : ndarray (n,)
        Time constant of each tap that is used.
    left_out : dict of str to int
        Number of taps that are not used, by reason.
    misfit : float
        Median rms residual of the fits relative to the taps' height.
    refused : str
        Why the time constant must not be used: the response is another than the model's, or faster than the samples; "" if it
        can be used.
    """

    response_s: float
    std_dev_s: float
    each_s: Array
    left_out: dict[str, int]
    misfit: float
    refused: str


def tap_response(stretches: Sequence[Array], interval_s: float, *, full_scale_mv: float) -> TapResponse:
    """Time constant of plate and cell from samples of taps.

    Parameters
    ----------
    stretches : sequence of ndarray (k,)
        Samples without gaps, mV.
    interval_s : float
        Time between samples, s.
    full_scale_mv : float
        Taps with samples at or beyond it are not used.

    Returns
    -------
    TapResponse

    Raises
    ------
    ValueError
        If fewer than five taps can be used.
    """
    left_out = dict.fromkeys(_LEFT_OUT, 0)
    taps: list[Array] = []
    for samples in stretches:
        taps += _taps(samples, interval_s, full_scale_mv, left_out)
    if len(taps) < LEAST_TAPS:
        raise ValueError(f"{len(taps)} taps that count{_said(left_out) or _weakness(stretches, len(taps))}")
    fits = [_fitted(tap, interval_s) for tap in taps]
    logs, misfits = np.array([fit.log_response for fit in fits]), np.array([fit.misfit for fit in fits])
    spread = SD_PER_MAD * np.median(np.abs(logs - np.median(logs)))
    counted = np.abs(logs - np.median(logs)) <= _OUTLIER_SDS * max(spread, _LEAST_SPREAD)
    left_out["unlike the others"] += int((~counted).sum())
    each, misfit = np.exp(logs[counted]), float(np.median(misfits))
    count = each.size
    factor = float(student.ppf(0.8413, count - 1)) if count > 1 else 1.0
    found, refused = float(np.exp(np.mean(np.log(each)))), ""
    scatter_s = float(found * np.std(np.log(each), ddof=1) / np.sqrt(count) * factor)
    # The variance in time of the impulse response is 2 tau^2, and that of the contact is added to it.
    std_dev = float(np.hypot(scatter_s, _CONTACT_SD_S**2 / (4.0 * found)))
    if misfit > _RINGING:
        ringing_hz = _strongest_hz([fit.left for fit, ok in zip(fits, counted, strict=True) if ok], interval_s)
        refused = (
            f"plate and cell do not answer a tap as a critically damped cell does: {100.0 * misfit:.0f} % of its height is left, "
            f"most of that at {ringing_hz:.0f} Hz"
        )
    elif (unlike := _unlike([fit for fit, ok in zip(fits, counted, strict=True) if ok], interval_s)) > _UNLIKE:
        refused = (
            f"plate and cell do not answer a tap as a critically damped cell does: {100.0 * unlike:.0f} % of the answer (rms) is "
            "left, so the damping is another or the blow too long"
        )
    elif found < interval_s:
        refused = f"plate and cell answer within a sample of {1e3 * interval_s:g} ms: faster samples would show it"
    return TapResponse(found, std_dev, each, {k: v for k, v in left_out.items() if v}, misfit, refused)


def _taps(samples: Array, interval_s: float, full_scale_mv: float, left_out: dict[str, int]) -> list[Array]:
    """Samples around each usable tap, relative to the rest value and with positive sign."""
    before, after, apart = (round(s / interval_s) for s in (_BEFORE_S, _AFTER_S, _APART_S))
    if samples.size < before:
        return []
    away = samples - float(np.median(samples))
    above = np.flatnonzero(np.abs(away) > _clear_mv(samples))
    if not above.size:
        return []
    groups = np.split(above, np.flatnonzero(np.diff(above) > before) + 1)
    begins = [int(group[0]) for group in groups]
    found = []
    for i, begin in enumerate(begins):
        window = slice(begin - before, begin + after)
        near = [other for j, other in enumerate(begins) if j != i and abs(other - begin) < apart]
        if near:
            left_out["too close to another"] += 1
        elif window.start < 0 or window.stop > samples.size:
            left_out[_CUT_OFF] += 1
        elif np.max(samples[window]) >= full_scale_mv:
            left_out["beyond the sensor's range"] += 1
        else:
            sign = 1.0 if np.sum(away[window]) > 0.0 else -1.0
            found.append(sign * away[window])
    return found


def _clear_mv(samples: Array) -> float:
    """Least distance from rest of a tap, mV."""
    noise = SD_PER_MAD * float(np.median(np.abs(samples - np.median(samples))))
    return _CLEAR * max(noise, 1e-9 + 1e-6 * float(np.ptp(samples)))


def _weakness(stretches: Sequence[Array], taps: int) -> str:
    """By how much the longest stretch has no tap, where its voltage moves."""
    longest = max(stretches, key=len)
    if taps or not np.ptp(longest):
        return ""
    largest, needed = float(np.max(np.abs(longest - np.median(longest)))), _clear_mv(longest)
    return (
        f"; no sample is further than {largest:.1f} mV from rest, and {needed:.1f} mV is {_CLEAR:.0f} times the noise and drift"
    )


@dataclass(frozen=True)
class _TapFit:
    """One tap's fit: ln time constant; rms residual, tap and residuals (k,), relative to its height; begin: its first sample."""

    log_response: float
    misfit: float
    tap: Array
    left: Array
    begin: int


def _fitted(tap: Array, interval_s: float) -> _TapFit:
    times = np.arange(tap.size) * interval_s
    peak = int(np.argmax(tap))
    height = float(tap[peak])
    begun = int(np.flatnonzero(tap > 0.1 * height)[0])

    def left(theta: Array) -> Array:
        late = np.maximum((times - theta[1]) / np.exp(theta[0]), 0.0)
        columns = np.column_stack((late * np.exp(-late), np.ones(times.size)))
        size, *_ = np.linalg.lstsq(columns, tap, rcond=None)
        return np.asarray((tap - columns @ size) / height)

    rise_s = max((peak - begun) * interval_s, 0.5 * interval_s)
    best = None
    for guess_s in (0.5 * rise_s, rise_s, 2.0 * rise_s):
        start = np.log(min(guess_s, 0.5 * LONGEST_RESPONSE_S)), (begun - 0.5) * interval_s
        bounds = ([np.log(0.1 * interval_s), 0.0], [np.log(LONGEST_RESPONSE_S), times[peak]])
        fit = least_squares(left, np.clip(start, *bounds), bounds=bounds, x_scale=[0.1, interval_s])
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None, "there is a start"
    rest = left(best.x)
    misfit = float(np.sqrt(np.mean(rest[tap.size // 10 : tap.size // 2] ** 2)))
    return _TapFit(float(best.x[0]), misfit, tap / height, rest, begun)


def _unlike(fits: Sequence[_TapFit], interval_s: float) -> float:
    """Rms residual of the taps relative to their rms, less what noise leaves with two deviations."""
    left, felt, during, quiet = 0.0, 0.0, 0, []
    for fit in fits:
        begin = max(fit.begin - 2, 0)
        lasts = slice(begin, begin + 4 + round(_LASTS * np.exp(fit.log_response) / interval_s))
        left += float(np.sum(fit.left[lasts] ** 2))
        felt += float(np.sum(fit.tap[lasts] ** 2))
        during += fit.left[lasts].size
        quiet.append(fit.left[: begin // 2])
    rest = np.concatenate(quiet)
    noise = float(np.mean(rest**2)) if rest.size else 0.0
    chance = 2.0 * noise * (2.0 * during * (1.0 + during / max(rest.size, 1))) ** 0.5
    return float(np.sqrt(max(left - noise * during - chance, 0.0) / felt))


def _strongest_hz(rests: Sequence[Array], interval_s: float) -> float:
    power = np.mean([np.abs(np.fft.rfft(rest)) ** 2 for rest in rests], axis=0)
    return float(np.fft.rfftfreq(rests[0].size, interval_s)[1 + int(np.argmax(power[1:]))])


def _said(left_out: dict[str, int]) -> str:
    said = ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count)
    return f" ({said})" if said else ""
