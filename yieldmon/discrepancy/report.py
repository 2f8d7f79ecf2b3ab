"""A report as one HTML page, with its pictures embedded and as files beside it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from math import degrees, isnan
from pathlib import Path

import numpy as np
import scipy

from yieldmon.errors import InputError
from yieldmon.files import whole_file
from yieldmon.physics.effects import get_effect, registry
from yieldmon.physics.machine import RPM
from yieldmon.physics.numerics import Array

from . import diagnosis_notes
from .choice import Step, rows_searched
from .confidence import MOST_AT_BOUND
from .diagnosis import Diagnosis, HeldOut, Measure
from .experiment import Plan
from .fit import Fit
from .lack_of_fit import Region
from .policy import DEFAULT

Intervals = tuple[tuple[float, float], tuple[float, float]]
"""Of the lack of fit before and after."""

_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2em .7em;border-bottom:1px solid #ccc;text-align:right}td:first-child,th:first-child{text-align:left}"
    "img{max-width:100%}.summary{background:#f2f5f7;padding:1em 1.3em;border-radius:6px}"
)


_PAGE_NAME = "index.html"
FILES = (_PAGE_NAME, "where.png", "after.png", "profiles.png", "ranking.png")
"""Files that `write_report` writes."""


def check_pictures() -> None:
    """Raises InputError if matplotlib, which is needed for the pictures, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError("--report", "needs matplotlib, which is not installed", "pip install 'yieldmon[plot]'") from error


def write_report(diagnosis: Diagnosis, folder: Path, title: str) -> Path:
    """Write index.html and PNGs into `folder`; returns the page. Raises InputError when matplotlib is not installed."""
    check_pictures()
    import matplotlib

    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    after, of_after = _after(diagnosis)
    limit_pct = max(0.5, *(float(np.max(np.abs(_errors_pct(f)))) for f in (diagnosis.base, after)))
    pictures = {
        "where": _residual_map(diagnosis.base, "Published model", limit_pct),
        "after": _residual_map(after, of_after, limit_pct),
        "profiles": _profiles(diagnosis),
        "ranking": _ranking(diagnosis),
    }
    page = folder / _PAGE_NAME
    files = {folder / f"{name}.png": content for name, content in pictures.items()}
    files[page] = _page(diagnosis, title, pictures).encode()
    for path, content in files.items():
        whole_file.write(path, content)
    return page


def summary(diagnosis: Diagnosis) -> str:
    """The finding in plain words."""
    before = diagnosis.before.rms_over_max_pct
    if diagnosis.verdict == "none":
        return _how_well(diagnosis)
    if diagnosis.verdict == "unknown":
        return (
            f"The model misses these measurements by {before:.1f} % of the largest reading, more than they scatter. "
            f"{_not_named(diagnosis)} Check the machine in the regions below, or measure the rows proposed."
        )
    text = (
        f"The model misses these measurements by {before:.1f} % of the largest reading. "
        f"{' '.join(_cause(s) for s in _named(diagnosis))}{_doubt(diagnosis)} "
        f"With this the error is {diagnosis.after.rms_over_max_pct:.1f} %"
    )
    held = diagnosis.held_out
    if held is not None:
        text += f"; {unseen(held)}"
        if held.closed_pct is not None and held.closed_pct <= 0.0:
            text += f", where the root mean square is no smaller ({held.before.rms:.4g} before, {held.after.rms:.4g} after)"
    return text + "."


_LIKELY = 0.5
"""Confidence from which a name is called the cause."""


def _how_well(diagnosis: Diagnosis) -> str:
    """Whether the model explains the rows within their repeatability, only within the usual model error, or not surely."""
    error = f"(error {diagnosis.before.rms_over_max_pct:.1f} % of the largest reading)"
    measure, base, most = diagnosis.before, diagnosis.base, diagnosis.options.policy.lack_of_fit_p
    f, p = measure.lack_of_fit_f, measure.p_value
    if f is not None and p is not None and p < most:
        return (
            f"The model fits the rows searched, but not all rows together {error}: F = {f:.2f}, p = {p:.1g}. "
            "Look at the held-out rows, or diagnose with --hold-out none."
        )
    if diagnosis_notes.repetitions_hide(diagnosis.choice, diagnosis.noise):
        return f"Repetitions scatter more than conditions do {error}, so these measurements do not show whether the model fits."
    if diagnosis_notes.many_left_out(diagnosis.outliers, len(diagnosis.rows)):
        return (
            f"The model fits the {diagnosis.fitted_rows.removeprefix('all ')} that are left {error}, but {diagnosis.outliers} of "
            f"{len(diagnosis.rows)} rows are left out as outliers: check these first."
        )
    if f is None or base.dof <= 0 or scipy.stats.f.sf(f, base.dof, diagnosis.noise.dof) >= most:
        return f"The model fits these measurements as well as they repeat {error}. Nothing to correct."
    own = 100.0 * base.frame.model_error
    return (
        f"The model fits these measurements within the {own:.1g} % by which models of the same physics differ {error}, "
        f"though they repeat better (F = {f:.2f}). Nothing to correct."
    )


def _not_named(diagnosis: Diagnosis) -> str:
    """Why no effect is named, and the best candidates."""
    found = diagnosis.with_leading
    if found is None:
        return "No known cause explains it."
    tied = 1 + len(diagnosis.choice.steps[0].equivalent)
    if tied > diagnosis.options.policy.largest_class:
        return f"{tied} effects explain these rows alike, so none is named; the best would leave {found.rms_over_max_pct:.1f} %."
    names = ", with ".join(_with_ties(step) for step in diagnosis.choice.steps)
    confidence = diagnosis.choice.steps[0].confidence
    how_often = (
        "how often such candidates are right is not known"
        if isnan(confidence)
        else f"of 100 cases that look like this one the first is right in {100.0 * confidence:.0f}"
    )
    return (
        "Something is missing, but what it is is not certain enough to be named. The best candidates: "
        f"{names}; they would leave {found.rms_over_max_pct:.1f} %, and {how_often}."
    )


def confidence_words(step: Step) -> str:
    """The confidence in a step in words."""
    return "confidence not known" if isnan(step.confidence) else f"confidence {step.confidence:.2f}"


def _with_ties(step: Step) -> str:
    return f"{step.added} (or {tied_names(step)})" if step.equivalent else step.added


def tied_names(step: Step) -> str:
    """Effects tied with a name; if too many, only their number (`--json` lists them)."""
    count = len(step.equivalent)
    return ", ".join(step.equivalent) if count < DEFAULT.largest_class else f"one of {count} others"


def _named(diagnosis: Diagnosis) -> tuple[Step, ...]:
    return diagnosis.choice.steps if diagnosis.verdict == "effect" else ()


def _cause(step: Step) -> str:
    """A sentence on a named effect, or on several that these data do not distinguish."""
    count = 1 + len(step.equivalent)
    if count == 1:
        summary = registry()[step.added].summary.rstrip(".")
        cause = "Cause" if step.confidence >= _LIKELY else "Possible cause"
        return f"{cause} ({step.confidence:.2f}): {summary[0].lower()}{summary[1:]}."
    if count > DEFAULT.largest_class:
        return f"More is missing, which {count} effects explain alike, {step.added} among them ({step.confidence:.2f} together)."
    names = ", ".join((step.added, *step.equivalent))
    cause = "Cause" if step.confidence >= _LIKELY else "Possible cause"
    return f"{cause}, one of {count} that these rows cannot tell apart ({step.confidence:.2f} together): {names}."


def _doubt(diagnosis: Diagnosis) -> str:
    """A sentence on a first name that is more likely wrong than right; "" for one that is not."""
    confidence = diagnosis.choice.steps[0].confidence
    if confidence >= _LIKELY:
        return ""
    at_most = "at most " if confidence == MOST_AT_BOUND else ""
    return (
        f" The names are uncertain: of 100 cases that look like this one the first is right in {at_most}{100.0 * confidence:.0f}."
        " They are given since with them the model predicts rows left out of the fits better; that helps within their range."
    )


def unseen(held: HeldOut) -> str:
    """Result on the held-out rows: their lack of fit before and after, with 95 % intervals."""
    before, after = held.before.lack_of_fit_f, held.after.lack_of_fit_f
    if before is None or after is None or held.f_interval is None:
        return f"{held.rows} held-out rows"
    (low, high), (least, most) = held.f_interval
    return (
        f"on {held.rows} held-out rows F = {before:.2f} ({low:.2f} to {high:.2f}) before and "
        f"{after:.2f} ({least:.2f} to {most:.2f}) after"
    )


def region_lines(regions: Sequence[Region]) -> list[str]:
    """Regions with an error of the model as lines of a table; none if there is no such region."""
    if not regions:
        return []
    head = f"  {'plate angle, deg':>18}{'fill':>16}{'speed, rpm':>14}{'model - measurement, %':>25}{'p':>9}"
    return ["  where the model is off:", head] + [
        f"  {_range(r.plate_angle_rad, degrees(1.0), 0):>18}{_range(r.fill, 1.0, 3):>16}"
        f"{_range(r.elevator_speed_rad_s, 1.0 / RPM, 0):>14}{r.mean_error_pct:>+25.1f}{r.p_value:>9.2g}"
        for r in regions
    ]


def _range(limits: tuple[float, float], scale: float, digits: int) -> str:
    """Both ends in the reader's unit; one number if they are equal to the digits shown."""
    low, high = (f"{v * scale:.{digits}f}" for v in limits)
    return low if low == high else f"{low} to {high}"


def plan_lines(plan: Plan) -> list[str]:
    """The next experiment as a table, with what it separates and its power."""
    if not plan.rows:
        return []
    lines = ["  next experiment, each row three times:", f"  {'plate angle, deg':>18}{'mass flow, kg/s':>18}{'speed, rpm':>14}"]
    lines += [
        f"  {degrees(r.plate_angle_rad):>18.0f}{r.mass_flow_kg_s:>18.1f}{r.elevator_speed_rad_s / RPM:>14.0f}" for r in plan.rows
    ]
    lines.append(f"  {'separates':>28}{'from':>28}{'power at the 5 % level':>25}")
    return lines + [
        f"  {a or 'no effect':>28}{b or 'no effect':>28}{power:>25.2f}"
        for (a, b), power in zip(plan.separates, plan.powers, strict=True)
    ]


def _figure(width: float, height: float):  # type: ignore[no-untyped-def]
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _png(figure) -> bytes:  # type: ignore[no-untyped-def]
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def _errors_pct(fitted: Fit) -> Array:
    """Model minus measurement of each cell, % of the largest reading."""
    return 100.0 * fitted.residual * fitted.frame.sd / float(np.max(np.abs(fitted.frame.cells.mean)))


def _load_label(fitted: Fit) -> str:
    return "mass flow, kg/s" if fitted.frame.cells.rows.load_name == "mass_flow_kg_s" else "mass per paddle, kg"


def _after(diagnosis: Diagnosis) -> tuple[Fit, str]:
    """The last model in the pictures, with the named effects, else the leading candidates, else none; and these effects."""
    if diagnosis.leading is not None:
        return diagnosis.leading, "With the leading candidates"
    return diagnosis.best, "With the named effects" if diagnosis.choice.named else "Published model"


def _residual_map(fitted: Fit, title: str, limit_pct: float) -> bytes:
    """limit_pct: end of the colour scale, the same before and after."""
    cells = fitted.frame.cells
    figure = _figure(7.5, 4.2)
    axes = figure.subplots()
    spread = 0.6 * (cells.elevator_speed_rad_s / np.median(cells.elevator_speed_rad_s) - 1.0)
    points = axes.scatter(
        np.degrees(cells.plate_angle_rad) + 6.0 * spread,
        cells.load,
        c=_errors_pct(fitted),
        cmap="RdBu_r",
        vmin=-limit_pct,
        vmax=limit_pct,
        s=110,
        edgecolors="0.4",
    )
    axes.set_xlabel("plate angle, deg")
    axes.set_ylabel(_load_label(fitted))
    axes.set_title(title, fontsize=10)
    figure.colorbar(points, label="model minus measurement,\n% of largest reading")
    return _png(figure)


def _profiles(diagnosis: Diagnosis) -> bytes:
    cells = diagnosis.base.frame.cells
    after, of_after = _after(diagnosis)
    lines = [(diagnosis.base, "Published model", "s--")] + [(after, of_after, "o-")] * (after is not diagnosis.base)
    figure = _figure(9.0, 4.0)
    for axes, values, label in zip(
        figure.subplots(1, 2),
        (np.degrees(cells.plate_angle_rad), cells.load),
        ("plate angle, deg", _load_label(diagnosis.base)),
        strict=True,
    ):
        order = np.unique(np.round(values, 6))
        for fitted, name, mark in lines:
            error = 100.0 * fitted.residual * fitted.frame.sd / np.maximum(np.abs(cells.mean), 0.05 * np.max(np.abs(cells.mean)))
            rms = [float(np.sqrt(np.mean(error[np.isclose(values, v, atol=1e-6)] ** 2))) for v in order]
            axes.plot(order, rms, mark, label=name)
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel(label)
        axes.set_ylabel("rms error, % of reading")
        axes.legend()
    return _png(figure)


def _ranking(diagnosis: Diagnosis) -> bytes:
    found = diagnosis.choice.looked_at[:12]
    figure = _figure(7.5, 0.6 + 0.32 * max(len(found), 1))
    axes = figure.subplots()
    names = [c.effect + (" (at a bound)" if c.refused else "") for c in found]
    chi2, dof = (np.array([getattr(c.fit, name) for c in found][::-1], dtype=float) for name in ("chi2", "dof"))
    dof = np.maximum(dof, 1.0)
    # Of a noncentral chi-square: variance 2 (dof + 2 excess).
    sd = np.sqrt(2.0 * (dof + 2.0 * np.maximum(chi2 - dof, 0.0)))
    axes.barh(names[::-1], chi2 / dof, xerr=sd / dof, color="#4a7fa5", ecolor="0.2", capsize=2)
    axes.axvline(1.0, color="0.3", linewidth=1)
    axes.axvline(diagnosis.choice.lack_of_fit_before.f, color="0.3", linewidth=1, linestyle="--")
    axes.set_xlim(left=0.0)
    axes.set_xlabel(
        f"lack of fit F {rows_searched(diagnosis.choice.base)}\n"
        "with this one effect added, and its standard deviation\n(line: the noise; dashed: none added)"
    )
    return _png(figure)


def _page(diagnosis: Diagnosis, title: str, pictures: dict[str, bytes]) -> str:
    def image(name: str, alt: str) -> str:
        return f'<img alt="{alt}" src="data:image/png;base64,{base64.b64encode(pictures[name]).decode()}">'

    e = html.escape
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{e(title)}</title><style>{_STYLE}</style><h1>{e(title)}</h1>",
        f'<p class="summary">{e(summary(diagnosis))}</p>',
        "<h2>Misfit</h2>",
        _misfit_table(diagnosis),
        "<h2>Where</h2>",
        _where_table(diagnosis),
        image("where", "residuals of the published model"),
        image("after", "residuals after"),
        image("profiles", "error by plate angle and by load"),
        "<h2>Candidates</h2>",
        image("ranking", "lack of fit by candidate"),
        *(_step(step, diagnosis) for step in diagnosis.choice.steps),
        "<h2>Next experiment</h2>",
        _plan_table(diagnosis),
        "<h2>Notes</h2><ul>" + "".join(f"<li>{e(n)}</li>" for n in diagnosis.notes) + "</ul>",
    ]
    if diagnosis.correction is not None:
        parts.append(
            "<h2>Stop-gap</h2><p>A Gaussian-process correction over "
            f"{e(', '.join(diagnosis.correction.axes))} takes up {diagnosis.correction.closed_pct:.0f} % "
            "of the excess on cells left out. "
            "It names no cause and holds only where these rows lie.</p>"
        )
    return "\n".join(parts) + "</html>\n"


def _misfit_table(diagnosis: Diagnosis) -> str:
    held = diagnosis.held_out
    rows: list[tuple[str, Measure, Measure | None, Intervals | None]] = []
    if diagnosis.with_leading is None:
        rows.append((f"{diagnosis.fitted_rows}, fitted to them", diagnosis.before, diagnosis.after, None))
    else:
        name = f"{diagnosis.fitted_rows}, fitted to them; after: with the leading candidates"
        rows.append((name, diagnosis.before, diagnosis.with_leading, None))
    if held is not None:
        # Without a name only the published model applies: there is no result after.
        after = held.after if diagnosis.verdict == "effect" else None
        rows.append((f"{held.rows} held-out rows, model fitted to the others", held.before, after, held.f_interval))
    head = ("", "rms before", "rms after", "% of max before", "after", "F before", "F after")
    out = "<table><tr>" + "".join(f"<th>{h}</th>" for h in head) + "</tr>"
    for name, before, after, intervals in rows:
        f = ["" if m is None or m.lack_of_fit_f is None else f"{m.lack_of_fit_f:.2f}" for m in (before, after)]
        if intervals is not None:
            f = [f"{value} ({low:.2f} to {high:.2f})" if value else "" for value, (low, high) in zip(f, intervals, strict=True)]
        rms, share = ("", "") if after is None else (f"{after.rms:.4g}", f"{after.rms_over_max_pct:.2f}")
        out += (
            f"<tr><td>{name}</td><td>{before.rms:.4g}</td><td>{rms}</td><td>{before.rms_over_max_pct:.2f}</td>"
            f"<td>{share}</td><td>{f[0]}</td><td>{f[1]}</td></tr>"
        )
    floor = f"Noise floor (rms of a perfect model): {diagnosis.noise_floor_rms:.4g}. In brackets: 95 % intervals."
    return out + f"</table><p>{floor}</p>"


def _where_table(diagnosis: Diagnosis) -> str:
    if not diagnosis.regions:
        return "<p>No region where the error is larger than chance allows.</p>"
    out = "<table><tr><th>plate angle, deg</th><th>fill</th><th>speed, rpm</th><th>model minus measurement, %</th><th>p</th></tr>"
    for r in diagnosis.regions:
        out += (
            f"<tr><td>{_range(r.plate_angle_rad, degrees(1.0), 0)}</td><td>{_range(r.fill, 1.0, 3)}</td>"
            f"<td>{_range(r.elevator_speed_rad_s, 1.0 / RPM, 0)}</td>"
            f"<td>{r.mean_error_pct:+.1f}</td><td>{r.p_value:.3g}</td></tr>"
        )
    return out + "</table>"


def _step(step: Step, diagnosis: Diagnosis) -> str:
    effect = registry()[step.added]
    fitted = diagnosis.best if diagnosis.choice.named else diagnosis.leading or diagnosis.choice.best
    values = ", ".join(
        f"{p.name.partition('.')[2]} = {fitted.values[p.name]:.4g} ± {sd:.2g} {html.escape(p.unit)}".rstrip()
        for p, sd in zip(fitted.parameters, np.sqrt(np.diag(fitted.covariance())), strict=True)
        if p.name.startswith(f"{step.law}.")
    )
    ties = f" Not distinguishable here from: {', '.join(step.equivalent)}." if step.equivalent else ""
    law = get_effect(step.law).law
    how = f" Law: {html.escape(law)}." if law else ""
    what = "" if diagnosis.choice.named else "partial candidate, "
    how_sure = f"{confidence_words(step).capitalize()}: " + (
        "no case with a known answer is like this one"
        if isnan(step.confidence)
        else "the share of names like this one, ties included, that were right on cases with known answers"
    )
    return (
        f"<h3>{step.added} ({what}{effect.stage})</h3><p>{html.escape(effect.summary)}{how} {values}. "
        f"{how_sure}.{ties} Signature: {html.escape(effect.signature)}.</p>"
    )


def _plan_table(diagnosis: Diagnosis) -> str:
    plan = diagnosis.plan
    if not plan.rows:
        return "<p>Nothing to separate.</p>"
    out = "<table><tr><th>plate angle, deg</th><th>mass flow, kg/s</th><th>elevator speed, rpm</th></tr>"
    for r in plan.rows:
        out += (
            f"<tr><td>{degrees(r.plate_angle_rad):.0f}</td><td>{r.mass_flow_kg_s:.1f}</td>"
            f"<td>{r.elevator_speed_rad_s / RPM:.0f}</td></tr>"
        )
    out += "</table><p>Each three times.</p><table><tr><th>separates</th><th>from</th><th>power at the 5 % level</th></tr>"
    for (a, b), power in zip(plan.separates, plan.powers, strict=True):
        out += f"<tr><td>{html.escape(a or 'no effect')}</td><td>{html.escape(b or 'no effect')}</td><td>{power:.2f}</td></tr>"
    return out + "</table>"
