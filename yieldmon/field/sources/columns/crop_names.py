"""The crop of each row: as the file says, and as a person says."""

from __future__ import annotations

import numpy as np

from yieldmon.field.crop_figures import crop
from yieldmon.field.table import Label


def crop_names(own: Label, given: str) -> tuple[Label, tuple[str, ...]]:
    """Names of crops, and what a person's name does where the file has others.

    A person's crop is that of rows without one, or with a name that is no crop's (a hybrid, a number). Where all rows have one
    other crop it replaces that: an operator forgot to change it. Where rows have several, they keep theirs.

    Parameters
    ----------
    own : Label
        As the file says, "" where it does not.
    given : str
        By a person; "" for none.

    Examples
    --------
    >>> crop_names(Label.of(["Wheat", "", "P1366", "Oats"]), "corn")[0].text().tolist()
    ['Wheat', 'corn', 'corn', 'Oats']
    >>> crop_names(Label.of(["Wheat", "Wheat"]), "barley")[1]
    ('the file says Wheat; its rows are named barley, as --crop says',)
    """
    count = len(own.codes)
    if not given:
        return own, ()
    there = np.unique(own.codes).tolist()
    known = {own.names[code]: facts for code in there if (facts := crop(own.names[code])) is not None}
    others = {name for name, facts in known.items() if facts != crop(given)}
    if len({facts.name for facts in known.values()}) < 2:
        note = f"the file says {', '.join(sorted(others))}; its rows are named {given}, as --crop says"
        return Label.constant(given, count), (note,) if others else ()
    names = [name if name in known else given for name in own.names]
    note = f"rows keep the crop that the file says ({', '.join(sorted(known))}); --crop {given} is for the others"
    return Label.of(np.array(names, object)[own.codes].tolist()), (note,)
