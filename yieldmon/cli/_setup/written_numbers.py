"""Numbers as people write them on paper: with a decimal comma, several in a row, with the unit of their own tape or scale."""

from __future__ import annotations

import re
import unicodedata

from yieldmon.units import KG_PER_LB, KG_PER_T, M_PER_FT, M_PER_IN, S_PER_H

#: Units taken in place of the one that is asked for, and what one of each is in that.
OTHER_UNITS: dict[str, dict[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2, "in": M_PER_IN, "inch": M_PER_IN, '"': M_PER_IN, "ft": M_PER_FT, "'": M_PER_FT},
    "kg": {"g": 1e-3, "t": KG_PER_T, "lb": KG_PER_LB, "lbs": KG_PER_LB},
    "kg/s": {"t/h": KG_PER_T / S_PER_H, "lb/s": KG_PER_LB},
    "mV": {"V": 1e3},
    "deg": {"°": 1.0, "degrees": 1.0},
    "rpm": {"1/min": 1.0},
}
_PART = re.compile(r"([-+]?[0-9][0-9.,]*(?:[eE][-+]?[0-9]+)?|[-+]?[.,][0-9]+)\s*([^\s0-9.,;+-]\S*?)?(?=[\s;,]|$)[\s;,]*")

_FRACTION = re.compile(r"(?:([0-9]+)[\s-]+)?([0-9]+)\s*[/⁄]\s*([1-9][0-9]*)")
_FEET_AND_INCHES = re.compile(r"([0-9]+)\s*(?:ft|')[\s-]*([0-9]+(?:\.[0-9]+)?)\s*(?:inch|in|\")")


def in_decimals(text: str) -> str:
    """A text with fractions, or with feet and inches of one length, as decimal numbers; "" for one without.

    >>> [in_decimals(text) for text in ("15 3/4 in", "6½ 8¼ in", "1 ft 2 in", "400 1/min", "15.75 in")]
    ['15.75 in', '6.5 8.25 in', '14 in', '', '']
    """
    apart = "".join(f" {unicodedata.normalize('NFKC', c)}" if unicodedata.numeric(c, 0) % 1 else c for c in text)
    decimal = _FRACTION.sub(lambda found: f"{int(found[1] or 0) + int(found[2]) / int(found[3]):.6g}", apart)
    inches = _FEET_AND_INCHES.sub(lambda found: f"{12 * int(found[1]) + float(found[2]):.6g} in", decimal)
    return "" if inches == text else inches.strip()


def numbers(text: str, unit: str) -> list[float]:
    """Of a text such as "165.6 207,1 mm" or "0,5,10"; a number without a unit has that of the next one behind it.

    Parameters
    ----------
    text : str
        Numbers with spaces or semicolons between them, or commas that cannot be decimal ones.
    unit : str
        In which numbers are returned, and which they have without one; "" for none.

    Returns
    -------
    list of float

    Raises
    ------
    ValueError
        With the text from where there is no number.
    KeyError
        For a unit that is none of this quantity.
    """
    text = text.strip()
    found: list[tuple[float, str]] = []
    place = 0
    while place < len(text):
        part = _PART.match(text, place)
        if part is None:
            raise ValueError(text[place:])
        digits = part[1].rstrip(",")
        several = digits.count(",") > 1 or "." in digits
        row = digits.split(",") if several else [digits.replace(",", ".")]
        if not all(row) or any(number.count(".") > 1 for number in row):
            raise ValueError(part[1])
        found += [(float(number), "") for number in row[:-1]]
        found.append((float(row[-1]), part[2] or ""))
        place = part.end()
    factor, values = 1.0, list[float]()
    for number, written in reversed(found):
        if written:
            factor = 1.0 if written == unit else OTHER_UNITS.get(unit, {})[written]
        # A factor of ten by division: 83.8 mm is 0.0838 m to the last digit.
        values.append(number / round(1.0 / factor) if factor < 1.0 and (1.0 / factor).is_integer() else number * factor)
    return values[::-1]
