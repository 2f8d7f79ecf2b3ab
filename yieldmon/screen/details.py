"""The signals of a message, each with its value, unit and the range seen, in as many columns as there is room for."""

from __future__ import annotations

from rich.text import Text

from yieldmon.bus.layout import MessageLayout, SignalLayout
from yieldmon.frames import Frame, Unusable

from . import values
from .blocks import wrapped
from .traffic import Row


def card(row: Row, layout: MessageLayout | None, frame: Frame | None, width: int, *, ranges: bool = True) -> list[Text]:
    """A title and the message's signals; its bytes where no DBC names it.

    Parameters
    ----------
    row, layout, frame
        What was seen, the DBC's layout and the last frame decoded; None for a message that no DBC names or of a wrong length.
    width : int
        Columns to use.
    ranges : bool
        Show least and greatest value as well.
    """
    data = bytes(row.last.data) if row.last is not None else b""
    name = f"{row.name} " if row.name else ""
    lines = wrapped(f"{name}{row.key[0]:0{8 if row.key[1] else 3}X}, {len(data)} bytes", width, style="bold")
    if frame is None or layout is None:
        wrong = "wrong length: " if layout is not None else ""
        return [*lines, *wrapped(f"{wrong}{data.hex(' ').upper()}", width, indent="   ")]
    flags = [signal for signal in layout.signals if signal.bits == 2]
    cells = []
    for signal in layout.signals:
        if signal.bits == 2:
            continue
        value = frame.signals[signal.name]
        span = ""
        if ranges and signal.name in row.extremes and signal.name not in values.CODES and not isinstance(value, Unusable):
            low, high = row.extremes[signal.name]
            span = f"{_end(signal, low)} to {_end(signal, high)}"
        cells.append((signal.name, values.text(signal, value), span))
    lines += _columns(cells, width)
    if flags:
        on = [signal.name for signal in flags if frame.signals[signal.name] == 1]
        lines += wrapped(f"on: {', '.join(on) if on else 'none'}", width, indent="   ")
    return lines


def _end(signal: SignalLayout, value: float) -> str:
    return str(value) if isinstance(value, int) else values.number(signal, value)


def _columns(cells: list[tuple[str, str, str]], width: int) -> list[Text]:
    """Cells side by side where they fit, one below the other where not; a cell wider than the pane takes two lines."""
    if not cells:
        return []
    name_w, value_w, span_w = (max(len(cell[part]) for cell in cells) for part in range(3))
    room = width - 3
    cell_w = name_w + 2 + value_w + (2 + span_w if span_w else 0)
    if cell_w > room:
        lines = []
        for name, value, span in cells:
            lines += wrapped(f"{name}  {value}", width, indent="   ", hanging="     ")
            lines += wrapped(span, width, indent="     ", hanging="     ", style="dim") if span else []
        return lines
    across = max(1, (room + 3) // (cell_w + 3))
    down = -(-len(cells) // across)
    lines = []
    for place in range(down):
        line = Text("   ")
        for column in range(across):
            index = column * down + place
            if index < len(cells):
                name, value, span = cells[index]
                line.append(f"{name:<{name_w}}  {value:>{value_w}}")
                line.append(f"  {span:<{span_w}}" if span_w else "", style="dim")
                line.append("   " if column + 1 < across else "")
        line.rstrip()
        lines.append(line)
    return lines
