"""Whether a table's readings are in the unit that its column names: no grain gives those of another one, or hardly any does."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from yieldmon.cli import _notes, model_options
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.files import parameter_file
from yieldmon.files.table import Table
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.resources import shipped

_FORCE_FACTOR = 5.0
_ASKED_FACTOR = 2.0
"""Times by which grains differ at most; t/h is 3.6 times, lb/s 2.2 times, a pound-force 4.4 times the unit of the table."""
_LIKELY_RIGHT = 0.75
"""Share of grain's readings from which units are not asked about: pounds for kilograms read 0.58 times the same grain."""
_LEAST_MOMENTUM_KG_M_S = 0.05
"""Below it an offset of the reading outweighs the grain."""


def no_question() -> str:
    """Of a table about which nothing is asked."""
    return ""


def ask(question: Callable[[], str]) -> None:
    """Of a table, once it could be used: a refusal is one line. question: that of `checked`."""
    if said := question():
        _notes.note(said)


def checked(data: Table, machine: Machine) -> Callable[[], str]:
    """Gives a question about readings in N or kg m/s that hardly any grain can give, "" for others; raises InputError for those
    that none can, typically because of their unit. The question takes fits, which a table that is refused need not wait for.

    Held against the shipped parameters: grains differ by a factor of two or less, a newton and a kilogram-force by ten. Readings
    that are too small are asked about unless the rows refute each unit that would make them so (`unit_question.possible`): grain
    may miss the plate, while none gives more than its momentum twice. Pounds for kilograms read some 0.6 times grain, as some
    grain does: asked about where the rows refute kilograms, or where paddles hold less than a row's load.
    """
    if data.reading == model_options.RESPONSE:
        return no_question
    unit = {"force_n": "newtons", "momentum_kg_m_s": "kg m/s for each paddle"}[data.reading]
    known = parameter_file.load(shipped(parameter_file.DEFAULT))
    values, load = model_options.momentum(data, machine)[0], model_options.loads(data)
    at = np.flatnonzero(np.isfinite(values) & (load > 0.0))
    conditions = model_options.conditions_at(data, machine, at)
    predicted = ForwardModel(machine, known.effects).paddle_momentum(conditions, known.values, overfull="nan").real
    usable = np.isfinite(predicted) & (np.abs(predicted) > _LEAST_MOMENTUM_KG_M_S)
    if not np.any(usable):
        return no_question
    ratio = float(np.median(values[at][usable] / predicted[usable]))
    if 1.0 / _FORCE_FACTOR <= ratio <= _FORCE_FACTOR:
        if _LIKELY_RIGHT <= ratio <= _ASKED_FACTOR:
            return no_question
        rows = Measurements(conditions, values[at])
        return partial(_question, data, machine, rows, ratio, unit, held=bool(np.all(np.isfinite(predicted))))
    hint = "; these look like kilograms-force (1 kgf is 9.807 N)" if 0.05 <= ratio <= 0.2 and data.reading == "force_n" else ""
    raise InputError(f"{data.path}: {data.reading}", f"is {ratio:.2g} times that of grain on this machine", unit + hint)


def _question(data: Table, machine: Machine, rows: Measurements, ratio: float, unit: str, *, held: bool) -> str:
    """That of `checked`. ratio: of the readings to those of grain; unit: theirs; held: whether paddles hold every load."""
    # A fit, and so scipy: most commands never ask.
    from yieldmon.estimation.weighing import unit_question

    model = ForwardModel(machine)
    # More than a paddle holds is no machine's load, and as good a reason to ask as rows that refute their unit.
    likely = 1.0 / _ASKED_FACTOR <= ratio < 1.0 and held
    if likely and not unit_question.stated_is_refuted(model, rows):
        return ""
    if ratio < 1.0 and not unit_question.possible(model, rows, (str(data.load), data.reading)):
        return ""
    load_unit = "kg for each paddle" if data.load == "paddle_mass_kg" else "kg/s, not t/h or lb/s"
    return (
        f"{data.path}: {data.reading} is {ratio:.2g} times that of grain on this machine: "
        f"is {data.load} in {load_unit}, and {data.reading} in {unit}?"
    )
