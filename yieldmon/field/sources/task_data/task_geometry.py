"""Where the header is, seen from the antenna whose places a log of task data has, by the device descriptions.

Offsets (DDI 134, 135) are from the reference point of the element's own device, ahead and to the right (ISO 11783-10). The header
of a combine may be a device of its own, coupled to the one that has the antenna.
"""

from __future__ import annotations

import numpy as np

from yieldmon.data_dictionary import DEFAULT_WIDTH, MAX_WIDTH, OFFSET_X, OFFSET_Y, WIDTH
from yieldmon.field.header_place import FARTHEST_M
from yieldmon.field.table import Array

from .task_values import Values

_WHOLE, _CONNECTOR, _ANTENNA = ("1", "2"), "6", "7"
"""Types of elements: a device and its functions, a connector, a navigation reference."""
_WIDTHS = (WIDTH, DEFAULT_WIDTH, MAX_WIDTH)
_LEAST_M = 0.01


def header_from_antenna(of: Values, count: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """How far the header's middle is ahead of the antenna and to the right of it, in each record of a log.

    Parameters
    ----------
    of : Values
        Of the log.
    count : int
        Its records.

    Returns
    -------
    columns : dict of str to array, shape (count,)
        Of a harvest table, m; none where the descriptions lack the place of header or antenna, or the offset between them.
    notes : tuple of str
        What was taken for granted, and offsets of an antenna that are not applied.
    """
    header, antenna = _header(of), _antenna(of)
    if header is None or antenna is None:
        return {}, _not_applied(of, header)
    ahead, right = (1e-3 * np.broadcast_to(one - other, count) for one, other in zip(header, antenna, strict=True))
    usual_ahead, usual_right = float(np.median(ahead)), float(np.median(right))
    said = f"{usual_ahead:.2f} m ahead of the antenna and {usual_right:.2f} m to the right, by the device descriptions"
    if max(np.abs(ahead).max(), np.abs(right).max()) > FARTHEST_M:
        return {}, (f"the header is said to be {said}: not used; expected {FARTHEST_M:g} m at most (--header-ahead)",)
    if max(np.abs(ahead).max(), np.abs(right).max()) < _LEAST_M:
        return {}, ()
    return {"header_ahead_m": ahead, "header_right_m": right}, (f"the header is {said} (else --header-ahead, --header-right)",)


_Place = tuple[Array, Array]


def _not_applied(of: Values, header: _Place | None) -> tuple[str, ...]:
    """A line on antennas away from their devices' reference points that cannot be seen from the header."""
    antennas = [element for element, kind in of.device.kinds.items() if kind == _ANTENNA]
    places = [place for element in antennas if (place := _place(of, element)) is not None]
    if not any(np.abs(axis).max() >= 1e3 * _LEAST_M for place in places for axis in place):
        return ()
    coupled = "which antenna is used" if len(antennas) > 1 else "how the header is coupled"
    lacks = "where the header is" if header is None else coupled
    said = f"are not applied, as the descriptions do not say {lacks} (--header-ahead, --header-right)"
    return (f"the antenna's offsets (DDI {OFFSET_X}, {OFFSET_Y}) {said}",)


def _header(of: Values) -> _Place | None:
    """mm from the measuring device's reference point: of the element with the width, of the only one, or of the sections."""
    own = [element for element, device in of.device.of_element.items() if device == of.measuring]
    wholes = [element for element in own if of.device.kinds[element] in _WHOLE and _place(of, element) is not None]
    wide = [element for element in wholes if any(_has(of, ddi, element) for ddi in _WIDTHS)]
    for chosen in (wide, wholes):
        if len(chosen) == 1:
            return _place(of, chosen[0])
    places = [place for section in own if section in of.device.sections and (place := _place(of, section)) is not None]
    if wholes or not places:
        return None
    x, y = (np.array([np.median(place[axis]) for place in places]) for axis in (0, 1))
    return np.array(x.mean()), np.array(0.5 * (y.min() + y.max()))


def _antenna(of: Values) -> _Place | None:
    """mm from the measuring device's reference point, through the coupling where another device has it."""
    antennas = [element for element, kind in of.device.kinds.items() if kind == _ANTENNA]
    antennas = [element for element in antennas if of.device.of_element[element] == of.measuring] or antennas
    if len(antennas) != 1:
        return None
    carrier, place = of.device.of_element[antennas[0]], _place(of, antennas[0])
    if carrier == of.measuring or place is None:
        return place
    coupling = _coupling(of, of.measuring, carrier)
    if coupling is None:
        return None
    (here_x, here_y), (there_x, there_y) = coupling
    return place[0] - there_x + here_x, place[1] - there_y + here_y


def _coupling(of: Values, one: str, other: str) -> tuple[_Place, _Place] | None:
    """The connector at which two devices are coupled, seen from each; as said, else the only one that each has."""
    device = of.device.of_element
    pairs = [pair for said in of.device.couplings for pair in (said, said[::-1])]
    ends = {(a, b) for a, b in pairs if device.get(a) == one and device.get(b) == other}
    if not ends:
        connectors = [
            [e for e, d in device.items() if d == of_device and of.device.kinds[e] == _CONNECTOR] for of_device in (one, other)
        ]
        ends = {(a, b) for a in connectors[0] for b in connectors[1]}
    if len(ends) != 1:
        return None
    here, there = (_place(of, element) for element in ends.pop())
    return None if here is None or there is None else (here, there)


def _place(of: Values, element: str) -> _Place | None:
    """Of an element that says how far ahead it is; in the middle where it does not say how far to a side."""
    ahead, right = (_offset(of, ddi, element) for ddi in (OFFSET_X, OFFSET_Y))
    return None if ahead is None else (ahead, np.array(0.0) if right is None else right)


def _offset(of: Values, ddi: int, element: str) -> Array | None:
    """As the log has it, before it is first sent as then; else as the description has it."""
    sent = of.values.get((ddi, element))
    known = np.flatnonzero(np.isfinite(sent)) if sent is not None else np.zeros(0, int)
    if sent is not None and known.size:
        return np.where(np.isfinite(sent), sent, sent[known[0]])
    constant = of.device.constants.get((ddi, element))
    return None if constant is None else np.array(constant)


def _has(of: Values, ddi: int, element: str) -> bool:
    return (ddi, element) in of.values or (ddi, element) in of.device.constants
