"""The machine's transport taken back: what comes off the elevator is a smeared picture of what the header cut.

Grain leaves the machine as from a first-order store: the flow at the sensor is the intake through exp(-t/tau)/tau, after the
delay. The intake is found by least squares with a penalty on its steps (Tikhonov), run by run in the frequency domain; each
run's mass is kept. Undoing a smear lets noise in, so the inverse has to earn its place: on blocks of passes that it was not
chosen on, opposing passes must agree better than with the delay alone, and than with a symmetric smoother of the same bandwidth.

Sources: Arslan, "A grain flow model to simulate grain yield sensor response", Sensors 8 (2008); Tikhonov and Arsenin,
"Solutions of ill-posed problems" (1977).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .delay import SHIFTS_S, block_sums, correlation_of
from .pairs import Pairs
from .table import Array
from .tracks import Tracks

TIME_CONSTANTS_S = (1.0, 2.0, 3.0, 4.0, 6.0)
PENALTIES = (0.3, 1.0, 3.0, 10.0)
DRAWS = 400
_AROUND_S = 8.0
_PAD = 64
_MIN_RUN = 16


@dataclass(frozen=True)
class Filter:
    """tau_s: time constant that is undone, 0 for the smoother alone. penalty: on squared steps, in units of squared residuals."""

    tau_s: float
    penalty: float


@dataclass(frozen=True)
class Transport:
    """Whether the inverse is better than its control.

    Parameters
    ----------
    better : bool
        Whether 97.5 % of draws of held-out blocks say so, against the shift alone and against the smoother.
    chosen : Filter
        Chosen on all blocks.
    shift_s : float
        Delay that goes with it.
    plain, smoothed, inverted : float
        Held-out correlation of opposing passes with the delay alone, the control, the inverse.
    margin, margin_sd : float
        inverted less the better of the other two, and its standard deviation over draws.
    """

    better: bool
    chosen: Filter
    shift_s: float
    plain: float
    smoothed: float
    inverted: float
    margin: float
    margin_sd: float


def filtered(steps: Tracks, one: Filter, *, control: bool = False) -> Array:
    """The flow of each step through the inverse, or through the control: the smoother of the same bandwidth without the inverse.

    Each run keeps its mass. Runs shorter than a few points, or with unknown flow, stay as they are.
    """
    out = steps.flow_kg_s.copy()
    first, last = steps.run_ends()
    for start, end in zip(first.tolist(), (last + 1).tolist(), strict=True):
        flow = steps.flow_kg_s[start:end]
        if end - start < _MIN_RUN or not np.isfinite(flow).all():
            continue
        length = 2 ** int(np.ceil(np.log2(end - start + 2 * _PAD)))
        padded = np.pad(flow, (_PAD, length - (end - start) - _PAD), mode="edge")
        response = np.fft.irfft(np.fft.rfft(padded) * _gain(length, steps.usual_interval_s, one, control), length)[
            _PAD : _PAD + end - start
        ]
        response = np.maximum(response, 0.0)
        mass = float((response * steps.interval_s[start:end]).sum())
        if mass > 0:
            out[start:end] = response * (float((flow * steps.interval_s[start:end]).sum()) / mass)
    return out


def _gain(length: int, interval_s: float, one: Filter, control: bool) -> Array:
    """conj(K) / (|K|^2 + penalty |D|^2) of the inverse; of the control its bandwidth, |K|^2 / (|K|^2 + penalty |D|^2)."""
    frequency = np.fft.rfftfreq(length, interval_s)
    step = np.exp(-2j * np.pi * frequency * interval_s)
    decay = np.exp(-interval_s / one.tau_s) if one.tau_s > 0 else 0.0
    kernel = (1.0 - decay) / (1.0 - decay * step)
    power = np.abs(kernel) ** 2
    bandwidth: Array = power / (power + one.penalty * np.abs(1.0 - step) ** 2)
    if control:
        return bandwidth
    inverse: Array = bandwidth / kernel
    return inverse


def assess(steps: Tracks, pairs: Pairs, delay_s: float, generator: np.random.Generator) -> Transport:
    """The inverse against its control.

    Parameters
    ----------
    steps, pairs
        Of a harvest whose delay is known.
    delay_s : float
        That delay; shifts about it are tried with every filter.
    generator : numpy.random.Generator
        Draws the blocks.
    """
    shifts = SHIFTS_S[np.abs(SHIFTS_S - round(delay_s)) <= _AROUND_S]
    candidates = [Filter(tau, penalty) for tau in TIME_CONSTANTS_S for penalty in PENALTIES]
    plain = block_sums(steps, pairs, "flow", shifts)
    inverse = [block_sums(replace(steps, flow_kg_s=filtered(steps, one)), pairs, "flow", shifts) for one in candidates]
    control = [
        block_sums(replace(steps, flow_kg_s=filtered(steps, one, control=True)), pairs, "flow", shifts) for one in candidates
    ]
    held = {name: np.zeros((6, pairs.blocks)) for name in ("plain", "smoothed", "inverted")}
    for half in (0, 1):
        learn, judge = slice(half, None, 2), slice(1 - half, None, 2)
        for name, tried in (("plain", [plain]), ("inverted", inverse)):
            index, shift = _best(tried, learn)
            held[name][:, judge] = tried[index][:, judge, shift]
            if name == "inverted":
                # The control has the bandwidth of the inverse that was chosen, and its own best shift.
                _, own = _best([control[index]], learn)
                held["smoothed"][:, judge] = control[index][:, judge, own]
    index, shift = _best(inverse, slice(None))
    scores = {name: float(correlation_of(sums.sum(axis=1)[:, None])[0]) for name, sums in held.items()}
    weights = generator.multinomial(pairs.blocks, np.full(pairs.blocks, 1.0 / pairs.blocks), size=DRAWS).astype(float)
    drawn = {name: correlation_of((sums @ weights.T)[:, :, None])[:, 0] for name, sums in held.items()}
    margins = drawn["inverted"] - np.maximum(drawn["plain"], drawn["smoothed"])
    return Transport(
        better=bool(np.percentile(margins, 2.5) > 0),
        chosen=candidates[index],
        shift_s=float(shifts[shift]),
        plain=scores["plain"],
        smoothed=scores["smoothed"],
        inverted=scores["inverted"],
        margin=scores["inverted"] - max(scores["plain"], scores["smoothed"]),
        margin_sd=float(margins.std()),
    )


def _best(tried: list[Array], blocks: slice) -> tuple[int, int]:
    scores = np.array([np.nan_to_num(correlation_of(sums[:, blocks].sum(axis=1)), nan=-2.0) for sums in tried])
    index, shift = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return int(index), int(shift)
