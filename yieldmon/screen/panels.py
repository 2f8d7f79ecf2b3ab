"""The screen, drawn with rich from a Traffic and a View: 80 x 24 upwards, rows that stay where they are."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.table import Table
from rich.text import Text

from yieldmon.bus.codec import Codec
from yieldmon.frames import (
    ACCUMULATED_MASS,
    MASS_FLOW,
    PLATE_ACTUATOR_FEEDBACK,
    SELF_CALIBRATION_STATUS,
    YIELD_MONITOR_STATUS,
    Value,
)

from . import values
from .traffic import Row, Traffic

ORDERS = ("id", "name", "rate", "count")
HEAD_LINES = 6
FOOT_LINES = 2
_BARS = " ▁▂▃▄▅▆▇█"
_DIGITS = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": (" ▀█", "  █", "  ▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    ".": (" ", " ", "▄"),
    "-": ("   ", "▀▀▀", "   "),
}


@dataclass(slots=True)
class View:
    """What the operator of the screen has chosen."""

    order: str = "id"
    needle: str = ""
    typing: bool = False
    paused: bool = False
    offset: int = 0
    recording: str = ""
    source: str = ""


class Screen:
    """Renderable: head with the figures, a table of frames, a line of keys."""

    def __init__(self, traffic: Traffic, codec: Codec, view: View) -> None:
        self._traffic = traffic
        self._codec = codec
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = (options.height or console.height) - HEAD_LINES - FOOT_LINES - 1
        width = options.max_width
        yield Group(self._head(width, plain=options.ascii_only), self._table(max(height, 1), width), self._foot(width))

    def _head(self, width: int, *, plain: bool) -> Group:
        """plain: the terminal's encoding has neither blocks nor lines."""
        traffic = self._traffic
        flow, quality = self._flow()
        big = _big(flow, plain=plain)
        mass, calibration = traffic.latest(ACCUMULATED_MASS), traffic.latest(SELF_CALIBRATION_STATUS)
        plate, status = traffic.latest(PLATE_ACTUATOR_FEEDBACK), traffic.latest(YIELD_MONITOR_STATUS)
        spread = traffic.latest(MASS_FLOW)
        side = [
            f"{'+-' if plain else '±'} {_number(spread.signals['MassFlowStdDev'], 2) if spread else '-'} kg/s   {quality}",
            f"plate {_number(plate.signals['PlateAngle'], 1) if plate else '-'} deg   sweep {_sweep(calibration)}",
            f"load {_number(mass.signals['LoadMass'], 0) if mass else '-'} kg"
            f"   total {_number(mass.signals['TotalMass'], 0) if mass else '-'} kg",
        ]
        if traffic.factory_kg_s is not None:
            side[0] += f"   factory {traffic.factory_kg_s:.2f} kg/s"
        lines = []
        for digits, beside in zip(big, side, strict=True):
            line = Text(no_wrap=True, overflow="crop")
            line.append(f" {digits:<20}", style="bold green" if flow is not None else "bold yellow")
            line.append(beside)
            line.truncate(width)
            lines.append(line)
        state = values.code_name("OperatingState", status.signals["OperatingState"]) if status else "no monitor on the bus"
        on = [name for name, value in status.signals.items() if name != "OperatingState" and value == 1] if status else []
        flows = [] if plain else list(traffic.flow_kg_s)[-(width - 8) :]
        trend = Text(f" kg/s {_sparkline(flows)}", no_wrap=True, overflow="crop")
        faults = Text(f" {state}   ", no_wrap=True, overflow="ellipsis")
        if status is not None:
            faults.append("faults: " + ", ".join(on) if on else "no faults", style="bold red" if on else "green")
        faults.truncate(width, overflow="ellipsis")
        return Group(*lines, trend, faults, Text(("-" if plain else "─") * width, style="dim"))

    def _flow(self) -> tuple[float | None, str]:
        frame = self._traffic.latest(MASS_FLOW)
        if frame is None:
            return None, "no MassFlow frames"
        row = next(r for r in self._traffic.rows.values() if r.name == MASS_FLOW)
        quality = values.code_name("EstimateQuality", frame.signals["EstimateQuality"])
        if row.is_stale(self._traffic.now_s):
            return None, f"stale, {row.age_s(self._traffic.now_s):.0f} s old"
        rate = frame.signals["MassFlowRate"]
        return (float(rate) if isinstance(rate, (int, float)) else None), quality

    def _table(self, height: int, width: int) -> Table:
        view, traffic = self._view, self._traffic
        rows = traffic.sorted_rows(view.order, view.needle)
        view.offset = max(0, min(view.offset, len(rows) - (height - 1)))
        table = Table(box=None, padding=(0, 1, 0, 0), width=width, header_style="bold", pad_edge=False)
        table.add_column(" id", width=9, no_wrap=True)
        table.add_column("message", width=22, no_wrap=True, overflow="ellipsis")
        table.add_column("Hz", width=6, justify="right", no_wrap=True)
        table.add_column("age s", width=6, justify="right", no_wrap=True)
        table.add_column("count", width=9, justify="right", no_wrap=True)
        table.add_column("signals", no_wrap=True, overflow="ellipsis", ratio=1)
        for row in rows[view.offset : view.offset + height - 1]:
            table.add_row(*self._cells(row), style="dim" if row.is_stale(traffic.now_s) else "")
        for _ in range(height - 1 - len(rows[view.offset : view.offset + height - 1])):
            table.add_row("")
        return table

    def _cells(self, row: Row) -> tuple[str, ...]:
        now = self._traffic.now_s
        frame = self._traffic.decoded(row)
        layout = self._codec.layout_of(row.key[0]) if row.key[1] else None
        if frame is not None and layout is not None:
            signals = values.line(layout, frame)
        else:
            signals = bytes(row.last.data).hex(" ").upper() if row.last is not None else ""
            if layout is not None:
                signals = f"wrong length: {signals}"
        age = row.age_s(now)
        stale = "!" if row.is_stale(now) else ""
        shown = f"{age:.1f}" if isfinite(age) and age < 1000.0 else ">999"
        identifier = f" {row.key[0]:0{8 if row.key[1] else 3}X}"
        return identifier, row.name, f"{row.rate_hz(now):.1f}", shown + stale, str(row.count), signals

    def _foot(self, width: int) -> Text:
        view, traffic = self._view, self._traffic
        total = sum(row.rate_hz(traffic.now_s) for row in traffic.rows.values())
        line = Text(no_wrap=True, overflow="crop")
        line.append(f" {view.source}  {traffic.frames} frames  {total:.0f}/s  {traffic.error_frames} error frames")
        line.append(f"  by {view.order}")
        if view.needle or view.typing:
            line.append(f"  filter: {view.needle}{'_' if view.typing else ''}", style="bold")
        if view.paused:
            line.append("  PAUSED", style="bold yellow")
        if view.recording:
            line.append(f"  recording {view.recording}", style="bold red")
        line.truncate(width)
        keys = Text(" q quit  space pause  s sort  / filter  j k scroll  r record", style="dim", no_wrap=True)
        keys.truncate(width)
        return Text("\n").join((line, keys))


def _big(flow_kg_s: float | None, *, plain: bool) -> tuple[str, str, str]:
    text = f"{flow_kg_s:.1f}" if flow_kg_s is not None else "--.-"
    if plain:
        return "", text, ""
    top, middle, bottom = (" ".join(_DIGITS[c][i] for c in text) for i in range(3))
    return top, middle, bottom


def _sparkline(flows: list[float | None]) -> str:
    known = [f for f in flows if f is not None]
    top = max([*known, 1.0])
    return "".join("·" if f is None else _BARS[min(8, max(0, round(8.0 * f / top)))] for f in flows)


def _number(value: Value, digits: int) -> str:
    return f"{value:.{digits}f}" if isinstance(value, (int, float)) else "-"


def _sweep(frame: object) -> str:
    signals = getattr(frame, "signals", None)
    if signals is None:
        return "-"
    state, progress = signals["SweepState"], signals["SweepProgress"]
    name = values.code_name("SweepState", state)
    return f"{name} {progress:.0f} %" if isinstance(progress, (int, float)) and progress > 0 else name
