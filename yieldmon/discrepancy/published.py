"""Fit of the published model to the rows of a diagnosis, and checks of the rows themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.fitting import angle_lines
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import EXCHANGED
from yieldmon.physics.numerics import Array

from .base_fit import base_frame, fit_base
from .diagnosis_notes import of_bounds
from .fit import Fit
from .frame import Frame
from .lack_of_fit import change_with_load
from .noise import Noise
from .observations import SAME_SPEED, Rows, cells

LEAST_RESTITUTION = 0.25
"""Value of 1 + restitution below which a fit describes something other than rebound, such as grain that shields the plate."""
_SAME = 0.01
"""p value above which readings at one angle and speed count as the same at every load."""
_SURE = 0.999
"""Least power with which a change with load would have been detected."""
_LEAST_MISFIT = 0.02
"""Rms residual over the largest reading from which it is asked whether a response is a mean force."""
_CLOSER = 2.5
"""Times by which the residual has to fall."""


@dataclass(frozen=True)
class Published:
    """The published model fitted to the rows of a diagnosis. form: "restitution" or "exchange". notes: on the fit, for the
    user."""

    form: str
    base: Fit
    notes: tuple[str, ...]

    @property
    def frame(self) -> Frame:
        """Frame of the following fits."""
        return self.base.frame


def fit_published(
    rows: Rows, noise: Noise, parameters: ParameterSet, *, form: str, keep_effects: bool, name: str = "table"
) -> Published:
    """Fit the published model to rows.

    Parameters
    ----------
    rows : Rows
        Rows that are not held out.
    noise : Noise
        Noise of the rows.
    parameters : ParameterSet
        Of the present model, for what is not fitted.
    form : {"auto", "restitution", "exchange"}
        Form of the impact; "auto": the restitution, or k1 and k2 if the parameters have these, the reading is not in an SI unit,
        or the restitution ends at its bound.
    keep_effects : bool
        See `Options`.
    name : str
        Name of the table in error messages.

    Returns
    -------
    Published

    Raises
    ------
    InputError
        For too few conditions, or loads that exceed the paddles of this machine.
    """
    grouped = cells(rows)
    sd = noise.of_cells(grouped)
    impact = form
    if form == "auto":
        impact = "exchange" if "k1" in parameters.values or not rows.si else "restitution"
    frame = base_frame(grouped, sd, parameters, impact, keep_effects=keep_effects)
    if len(frame.base) + 3 > len(grouped):
        raise InputError(name, f"has {len(grouped)} distinct conditions to fit", f"at least {len(frame.base) + 3}")
    notes: list[str] = []
    try:
        base = fit_base(frame)
        if form == "auto" and impact == "restitution" and "restitution" in base.at_bound:
            notes.append(EXCHANGED)
            impact = "exchange"
            base = fit_base(base_frame(grouped, sd, parameters, impact, keep_effects=keep_effects))
    except ValueError as error:
        raise InputError(name, str(error), "loads that a paddle of this machine can hold") from error
    return Published(impact, base, (*notes, *of_bounds(base)))


def exchange_instead(
    published: Published, rows: Rows, noise: Noise, parameters: ParameterSet, *, keep_effects: bool, name: str = "table"
) -> Published | None:
    """The published model with k1 and k2, if its restitution is lower than that of grain; None if it is not.

    published, rows, noise, parameters, keep_effects, name: those of the fit with `form="auto"`.
    """
    value = published.base.values.get("restitution", LEAST_RESTITUTION)
    if published.form != "restitution" or value >= LEAST_RESTITUTION:
        return None
    why = (
        f"restitution is {value:.2g}, less than grain's on steel ({LEAST_RESTITUTION:g} and more): the published exchange "
        "coefficients k1, k2 are fitted in its place"
    )
    other = fit_published(rows, noise, parameters, form="exchange", keep_effects=keep_effects, name=name)
    return replace(other, notes=(why, *other.notes))


def check_load(base: Fit, noise: Noise, name: str) -> None:
    """Raises InputError if readings do not change with load, although the model's change would have been detected."""
    change, power = change_with_load(base, noise)
    if change.p_value >= _SAME and power > _SURE:
        raise InputError(
            name,
            f"has readings that do not change with load beyond their scatter (F = {change.f:.2f}, p = {change.p_value:.1g})",
            "readings of these loads; the right columns?",
        )


def angles_asked(rows: Rows, published: Published, noise: Noise, parameters: ParameterSet, *, keep_effects: bool) -> str:
    """A question to the user if the model explains the rows far better with plate angles on another line; "" if it does not.

    rows, noise, parameters, keep_effects: those of the fit of `published`.
    """

    def refit(plate_angle_rad: Array) -> float:
        turned = replace(rows, plate_angle_rad=plate_angle_rad)
        return _misfit(fit_published(turned, noise, parameters, form=published.form, keep_effects=keep_effects).base, turned)

    return angle_lines.question(rows.plate_angle_rad, _misfit(published.base, rows), refit)


def response_asked(rows: Rows, published: Published, noise: Noise, parameters: ParameterSet, *, keep_effects: bool) -> str:
    """A question to the user if the model explains a `response` far better as a mean force; "" if it does not.

    A response is in proportion to the momentum of one paddle, a mean force to that times the paddles per second, so that rows of
    one speed cannot show the difference. rows, noise, parameters, keep_effects: those of the fit of `published`.
    """
    passes = rows.machine.passes_per_s(rows.elevator_speed_rad_s)
    before = _misfit(published.base, rows)
    if rows.si or np.ptp(passes) < SAME_SPEED * np.max(passes) or before < _LEAST_MISFIT:
        return ""
    divided = replace(rows, value=rows.value * float(np.median(passes)) / passes)
    try:
        after = fit_published(divided, noise, parameters, form=published.form, keep_effects=keep_effects).base
    except InputError:
        return ""
    if not _CLOSER * _misfit(after, divided) < before:
        return ""
    return (
        f"divided by its elevator speed the response would be missed by {100.0 * _misfit(after, divided):.2g} % of the largest "
        f"instead of {100.0 * before:.2g} %: is it a mean force? A `response` is in proportion to the momentum of one paddle. "
        "Nothing is named."
    )


def _misfit(found: Fit, measured: Rows) -> float:
    """Root mean square of what a fit leaves over the largest reading."""
    away = found.predict(measured) - measured.value
    return float(np.sqrt(np.mean(away**2)) / np.max(np.abs(measured.value)))
