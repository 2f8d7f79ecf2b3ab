"""Which signals of a survey could serve which quantity, the likeliest first."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from yieldmon.bus.databases import SignalBits
from yieldmon.engine.sources import QUANTITIES
from yieldmon.network.name import Name
from yieldmon.signals.binding import IMPACT
from yieldmon.signals.extraction import named_no_value
from yieldmon.signals.signal_fit import HINTS, STANDS_OUT, WEAK, score
from yieldmon.signals.state_names import codes_by_name
from yieldmon.signals.survey import PAST_ADDRESSES, MessageSeen, Survey

_VALID, _MOST_OF_A_FLAG = re.compile(r"(?<!in)valid", re.IGNORECASE), 2
"""Names and bits of signals that say by 1 whether others of the message are valid."""
_FITS_ALIKE = 0.02
"""Scores of two signals of which nothing says which fits better: they move, or come, a little more often."""


@dataclass(frozen=True)
class Candidate:
    """A signal that could serve a quantity.

    unit: as the DBC says; mux: value of the multiplexer with which it is sent most, and every_mux all values with which it is,
    where these are several, at every_rate_hz together; source: of the sender where the DBC does
    not distinguish it from others; node: the sender's NAME then, where it is known; moved: that node came from several
    addresses; span: lowest and highest value; not_available: raw values that the DBC's value table calls so; values: raw value
    and code of a switch whose names say that they differ; valid: the one signal of the message that says by 1 that it is; score:
    how well it fits, above 0.
    """

    quantity: str
    dbc: str
    message: str
    signal: str
    unit: str
    rate_hz: float
    mux: int | None = None
    every_mux: tuple[int, ...] = ()
    every_rate_hz: float = 0.0
    source: int | None = None
    node: Name | None = None
    moved: bool = False
    span: tuple[float, float] = (0.0, 0.0)
    not_available: tuple[int, ...] = ()
    values: tuple[tuple[int, int], ...] = ()
    valid: str | None = None
    score: float = 1.0

    @property
    def weak(self) -> bool:
        """Whether nothing but its unit speaks for it."""
        return self.score <= WEAK


def candidates_of(survey: Survey) -> dict[str, list[Candidate]]:
    """Quantity -> the signals that could serve it, the likeliest first; quantities without any are left out."""
    found: dict[str, list[Candidate]] = {}
    messages = survey.messages
    senders = Counter((message.dbc, message.name) for message in messages)
    homes = Counter(name for address, name in survey.claims.items() if name is not None and address < PAST_ADDRESSES)
    for message in messages:
        if message.dbc is None or message.rate_hz is None or message.name is None:
            continue
        multiplexers = {signal.bits.mux_by for signal in message.signals.values()}
        measured = [signal for signal in message.signals.values() if signal.bits.name not in multiplexers]
        for signal in measured:
            mux, frames = signal.page
            rate_hz = message.rate_hz * frames / message.frames
            for quantity in HINTS:
                fits = score(quantity, message, signal, rate_hz)
                if fits > 0.0:
                    place = message.dbc, message.name, signal.bits.name
                    several = senders[message.dbc, message.name] > 1 or survey.is_elsewhere(message)
                    source = message.source if several else None
                    node = survey.claims.get(source) if source is not None else None
                    candidate = Candidate(
                        quantity,
                        *place,
                        unit=signal.bits.unit,
                        rate_hz=rate_hz,
                        mux=mux,
                        every_mux=tuple(sorted(signal.pages)) if len(signal.pages) > 1 else (),
                        every_rate_hz=message.rate_hz * sum(signal.pages.values()) / message.frames,
                        source=source,
                        node=node,
                        moved=node is not None and homes[node] > 1,
                        span=(signal.low, signal.high),
                        not_available=_not_available(quantity, signal.bits),
                        values=tuple(sorted(codes_by_name(quantity, signal.bits).items())),
                        valid=_valid(message),
                        score=fits,
                    )
                    found.setdefault(quantity, []).append(candidate)
    return {
        quantity: list(dict.fromkeys(sorted(scored, key=lambda candidate: -candidate.score)))
        for quantity, scored in sorted(found.items())
    }


def _not_available(quantity: str, bits: SignalBits) -> tuple[int, ...]:
    """Raw values that a value table calls no value, beside those that J1939 keeps. A state may well be "fault"."""
    if quantity not in IMPACT and not QUANTITIES[quantity].unit:
        return ()
    return tuple(sorted(named_no_value(bits)))


def _valid(message: MessageSeen) -> str | None:
    """The signal that says whether the others of a message are valid, where there is one."""
    of_all = [signal.bits for signal in message.signals.values() if signal.bits.mux_by is None]
    flags = [bits.name for bits in of_all if bits.bits <= _MOST_OF_A_FLAG and _VALID.search(bits.name)]
    return flags[0] if len(flags) == 1 else None


def fit_alike(one: Candidate, other: Candidate) -> bool:
    """Whether nothing says which of two candidates for a quantity is the likelier, the first or the other."""
    if one.weak or other.weak or one.score - other.score > _FITS_ALIKE:
        return False
    if one.quantity not in IMPACT:
        return True
    moved, less = (candidate.span[1] - candidate.span[0] for candidate in (one, other))
    return moved < STANDS_OUT * less
