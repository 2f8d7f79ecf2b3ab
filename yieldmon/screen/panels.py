"""The frames' screen, drawn with rich from a Traffic and a View: 80 x 24 upwards, rows that stay where they are.

The list has a row for each identifier, with its bytes; those that have just changed stand out. The row chosen with j and k shows
its signals: below the list, or beside it from `WIDE` columns on, where the rows after it show theirs as well. No value is cut.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.text import Text

from yieldmon.frames import (
    ACCUMULATED_MASS,
    MASS_FLOW,
    PLATE_ACTUATOR_FEEDBACK,
    SELF_CALIBRATION_STATUS,
    YIELD_MONITOR_STATUS,
    Frame,
    Value,
)
from yieldmon.units import UNKNOWN, Units

from . import values
from .blocks import fitted, large, rule, sparkline, wrapped
from .details import card
from .traffic import Row, Traffic

ORDERS = ("id", "name", "rate", "count")
WIDE = 118
"""Columns from which on the signals stand beside the list."""
_LIST = 80
_CHANGE_SHOWN_S = 1.0
_BYTES = 8
_BYTES_W = 3 * _BYTES - 1
_LEAST_ROWS = 3
_DIGITS_AND_TREND = 4
"""Lines of the head that show the flow large."""


@dataclass(slots=True)
class View:
    """What the operator of the screen has chosen. selected: place in the list; silence: why the daemon's words are missing."""

    order: str = "id"
    needle: str = ""
    typing: bool = False
    paused: bool = False
    selected: int = 0
    recording: str = ""
    source: str = ""
    cab: bool = False
    silence: str = ""
    units: Units = field(default_factory=Units)


class Screen:
    """Renderable: head with the figures, the list of frames, signals of the chosen one, a line of keys."""

    def __init__(self, traffic: Traffic, view: View) -> None:
        self._traffic = traffic
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, plain = options.max_width, options.ascii_only
        head, foot = self._head(width, plain=plain), self._foot(width)
        if len(head) + len(foot) + _LEAST_ROWS >= (options.height or console.height):
            # A low window: the digits go, then the keys.
            flow = f" {self._view.units.flow(self._flow()[0])}   {self._flow()[1]}"
            head = [Text(flow, no_wrap=True), *head[_DIGITS_AND_TREND:]]
            if len(head) + len(foot) + _LEAST_ROWS >= (options.height or console.height):
                foot = self._status_line(width)
        height = max((options.height or console.height) - len(head) - len(foot) - 1, 1)
        rows = self._traffic.sorted_rows(self._view.order, self._view.needle)
        self._view.selected = max(0, min(self._view.selected, len(rows) - 1))
        body = self._beside(rows, width, height) if width >= WIDE else self._below(rows, width, height, plain=plain)
        body += [Text("")] * (height - len(body))
        yield Group(*fitted([*head, *body[:height], *foot], width))

    # Head and foot

    def _head(self, width: int, *, plain: bool) -> list[Text]:
        traffic, units = self._traffic, self._view.units
        flow, quality = self._flow()
        unit = units.flow_unit
        mass, calibration = traffic.latest(ACCUMULATED_MASS), traffic.fresh(SELF_CALIBRATION_STATUS)
        plate, status = traffic.fresh(PLATE_ACTUATOR_FEEDBACK), traffic.latest(YIELD_MONITOR_STATUS)
        spread, silent_s = traffic.fresh(MASS_FLOW), traffic.overdue_s(YIELD_MONITOR_STATUS)
        around = units.flow(_number(spread.signals["MassFlowStdDev"])) if spread else f"{UNKNOWN} {unit.name}"
        side = [
            f"{'+-' if plain else '±'} {around}   {quality}",
            f"plate {_fixed(plate.signals['PlateAngle'], 1) if plate else UNKNOWN} deg   sweep {_sweep(calibration)}",
            f"load {units.mass(_number(mass.signals['LoadMass']) if mass else None)}"
            f"   total {units.mass(_number(mass.signals['TotalMass']) if mass else None)}",
        ]
        if traffic.factory_kg_s is not None:
            side[0] += f"   factory {units.flow(traffic.factory_kg_s)}"
        shown = "--.-" if flow is None else f"{unit.of(flow):.1f}" if unit.of(flow) < 1000.0 else f"{unit.of(flow):.0f}"
        digits = large(shown, plain=plain)
        column = max(20, max(map(len, digits)) + 2)
        lines = []
        for piece, beside in zip(digits, side, strict=True):
            line = Text(no_wrap=True)
            line.append(f" {piece:<{column}}", style="bold green" if flow is not None else "bold yellow")
            line.append(beside)
            lines.append(line)
        flows = [] if plain else list(traffic.flow_kg_s)[-(width - 8) :]
        lines.append(Text(f" {unit.name} {sparkline(flows)}", no_wrap=True))
        state = values.code_name("OperatingState", status.signals["OperatingState"]) if status else "no monitor on the bus"
        if status is None:
            lines += wrapped(state, width)
        else:
            on = [name for name, value in status.signals.items() if name != "OperatingState" and value == 1]
            active = f"faults: {', '.join(on)}" if on else "no faults"
            old = f"   STALE: as it was {silent_s:.0f} s ago" if silent_s is not None else ""
            lines += wrapped(f"{state}   {active}{old}", width, style="bold red" if on or old else "green")
        if self._view.silence:
            lines += wrapped(self._view.silence, width, style="bold red")
        return [*lines, rule(width, plain=plain)]

    def _flow(self) -> tuple[float | None, str]:
        frame = self._traffic.latest(MASS_FLOW)
        if frame is None:
            return None, "no MassFlow frames"
        row = next(r for r in self._traffic.rows.values() if r.name == MASS_FLOW)
        quality = values.code_name("EstimateQuality", frame.signals["EstimateQuality"])
        if row.is_stale(self._traffic.now_s):
            return None, f"stale, {row.age_s(self._traffic.now_s):.0f} s old"
        return _number(frame.signals["MassFlowRate"]), quality

    def _foot(self, width: int) -> list[Text]:
        keys = "q quit  space pause  s sort  / filter  j k choose  r record  c cab  u units"
        return [*self._status_line(width), *wrapped(keys, width, hanging=" ", style="dim")]

    def _status_line(self, width: int) -> list[Text]:
        view, traffic = self._view, self._traffic
        total = sum(row.rate_hz(traffic.now_s) for row in traffic.rows.values())
        parts = [
            view.source,
            f"{traffic.frames} frames",
            f"{total:.0f}/s",
            f"{traffic.error_frames} error frames",
            f"by {view.order}",
        ]
        if view.needle or view.typing:
            parts.append(f"filter: {view.needle}{'_' if view.typing else ''}")
        if view.paused:
            parts.append("PAUSED")
        if view.recording:
            parts.append(f"recording {view.recording}")
        lines = wrapped("  ".join(part for part in parts if part), width, hanging=" ")
        for line in lines:
            line.highlight_words(["PAUSED"], "bold yellow")
            line.highlight_words([f"recording {view.recording}", f"filter: {view.needle}"], "bold red")
        return lines

    # List and signals

    def _below(self, rows: list[Row], width: int, height: int, *, plain: bool) -> list[Text]:
        if not rows:
            return [self._titles(width, rows)]
        below = self._card(rows[self._view.selected], width)
        room = max(_LEAST_ROWS, min(len(rows) + 1, height - len(below) - 1))
        shown = self._list(rows, width, room)
        line = [rule(width, plain=plain)]
        left = height - len(shown) - 1
        if len(below) > left > 0:
            below = [*below[: left - 1], Text("   more: a taller window shows it", style="dim")]
        return [*shown, *line, *below] if left > 1 else shown

    def _beside(self, rows: list[Row], width: int, height: int) -> list[Text]:
        left = self._list(rows, _LIST, height)
        pane = width - _LIST - 1
        right: list[Text] = []
        for place, row in enumerate(rows[self._view.selected :]):
            found = self._card(row, pane, ranges=place == 0)
            if right and len(right) + len(found) > height:
                break
            right += found
        lines = []
        for number in range(max(len(left), len(right))):
            line = left[number].copy() if number < len(left) else Text("")
            line.pad_right(_LIST - line.cell_len)
            if number < len(right):
                line.append(" ")
                line.append_text(right[number])
            lines.append(line)
        return lines

    def _card(self, row: Row, width: int, *, ranges: bool = True) -> list[Text]:
        return card(row, self._traffic.layout_of(row), self._traffic.decoded(row), width, ranges=ranges)

    def _widths(self, width: int, rows: list[Row]) -> tuple[int, int, bool]:
        """Of the name and of the count, and whether there is room for bytes."""
        count = max([7, *(len(str(row.count)) for row in rows)])
        name = max([12, *(len(row.name) for row in rows)])
        fixed = 10 + 7 + 8 + count + 1
        bytes_fit = fixed + name + 1 + _BYTES_W <= width
        return (name if bytes_fit else max(4, min(name, width - fixed))), count, bytes_fit

    def _titles(self, width: int, rows: list[Row]) -> Text:
        name, count, bytes_fit = self._widths(width, rows)
        text = f" {'id':<8} {'message':<{name}} {'Hz':>6} {'age s':>7} {'count':>{count}}"
        return Text(text + (" bytes" if bytes_fit else ""), style="bold")

    def _list(self, rows: list[Row], width: int, height: int) -> list[Text]:
        """Titles and the rows around the chosen one, `height` lines at most."""
        room, chosen = max(height - 1, 1), self._view.selected
        first = max(0, min(chosen - room // 2, len(rows) - room))
        name, count, bytes_fit = self._widths(width, rows)
        lines = [self._titles(width, rows)]
        for place, row in enumerate(rows[first : first + room], first):
            lines.append(self._row(row, name, count, bytes_fit, chosen=place == chosen))
        return lines

    def _row(self, row: Row, name: int, count: int, bytes_fit: bool, *, chosen: bool) -> Text:
        now = self._traffic.now_s
        age = row.age_s(now)
        stale = row.is_stale(now)
        shown = (f"{age:.1f}" if isfinite(age) and age < 1000.0 else ">999") + ("!" if stale else "")
        identifier = f"{row.key[0]:0{8 if row.key[1] else 3}X}"
        line = Text(no_wrap=True, style="dim" if stale else "")
        line.append(">" if chosen else " ", style="bold")
        line.append(f"{identifier:<8} {row.name[:name]:<{name}} {row.rate_hz(now):>6.1f} {shown:>7} {row.count:>{count}}")
        if bytes_fit and row.last is not None:
            data = bytes(row.last.data)
            for place, byte in enumerate(data[: _BYTES - 1 if len(data) > _BYTES else _BYTES]):
                fresh = place < len(row.changed_s) and now - row.changed_s[place] < _CHANGE_SHOWN_S
                line.append(" ")
                line.append(f"{byte:02X}", style="bold reverse" if fresh else "")
            line.append(f" +{len(data) - _BYTES + 1}" if len(data) > _BYTES else "")
        return line


def _number(value: Value) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _fixed(value: Value, digits: int) -> str:
    return f"{value:.{digits}f}" if isinstance(value, int | float) else UNKNOWN


def _sweep(frame: Frame | None) -> str:
    if frame is None:
        return UNKNOWN
    state, progress = frame.signals["SweepState"], frame.signals["SweepProgress"]
    name = values.code_name("SweepState", state)
    return f"{name} {progress:.0f} %" if isinstance(progress, int | float) and progress > 0 else name
