"""The cab's screen: load, yield, flow, moisture, and each fault with its remedy; drawn from what a daemon's status says.

Without a daemon on this computer the same is read off the frames on the bus, as far as they report it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.text import Text

from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.frames import (
    ACCUMULATED_MASS,
    GRAIN_CONDITION,
    MASS_FLOW,
    PLATE_ACTUATOR_FEEDBACK,
    SELF_CALIBRATION_STATUS,
    VEHICLE_DIRECTION_SPEED,
    YIELD_MONITOR_STATUS,
    OperatingState,
    Value,
)
from yieldmon.units import M_S_PER_KMH, UNKNOWN, Unit, Units, moisture

from . import values
from .blocks import fitted, large, rule, wrapped
from .panels import View
from .traffic import Traffic

Status = Mapping[str, Any]
KEYS = "l load  x crop  t ticket  z zero  w sweep  u units  c bus  space pause  q quit"
NO_MONITOR, WAITS = "no monitor on the bus", "waiting for the daemon"
"""In place of a state."""
_BESIDE = 16
"""Columns of a line with two figures beside these."""
_GOOD = ("harvesting", "sweeping", "not_harvesting")


class Cab:
    """Renderable: the status of a daemon, or what the bus reports of one.

    Parameters
    ----------
    status : Mapping
        As `yieldmon status --json` prints it; keys that are not known are None.
    units : Units
        What people read.
    prompt : str
        A question, what is typed, or what became of it; "" for none.
    view : View
        For the words below.
    """

    def __init__(self, status: Status, units: Units, prompt: str, view: View) -> None:
        self._status = status
        self._units = units
        self._prompt = prompt
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, plain = options.max_width, options.ascii_only
        height = options.height or console.height
        head = [*self._title(width), *self._large(width, plain=plain), *self._figures(width), rule(width, plain=plain)]
        foot = self._foot(width, plain=plain)
        faults = self._faults(width, max(height - 1 - len(head) - len(foot), 1))
        if len(head) + len(faults) + len(foot) >= height:
            yield Group(*fitted(self._short(width, height - 1, plain=plain), width))
            return
        rest = max(height - 1 - len(head) - len(faults) - len(foot), 0)
        yield Group(*fitted([*head, *faults, *[Text("")] * rest, *foot], width))

    def _short(self, width: int, height: int, *, plain: bool) -> list[Text]:
        """What a low window has room for: what is asked first, then state and faults, then figures."""
        title, faults, asked = self._title(width), self._faults(width, 1), self._asked(width)
        left = max(height - len(title) - len(faults) - len(asked), 0)
        figures = self._figures(width)
        flow = self._large(width, plain=plain)
        if len(flow) + 2 > left:
            flow = [Text(f" flow   {self._units.flow(self._status['now']['mass_flow_kg_s'])}", no_wrap=True)]
        body = [*flow, *figures][:left]
        return [*[*title, *faults, *body][: max(height - len(asked), 0)], *asked[-height:]]

    def _title(self, width: int) -> list[Text]:
        status, load = self._status, self._status["load"]
        state = status["state"].replace("_", " ").upper()
        names = " ".join(name for name in (load["field"], load["crop"]) if name)
        closed = "" if load["open"] is not False else " (closed)"
        title = f"load {load['number']}{closed} {names}".strip() if load["number"] is not None else ""
        line = Text(no_wrap=True)
        line.append(f" {state} ", style="reverse green" if status["state"] in _GOOD else "reverse bold yellow")
        lines = [line]
        if self._view.silence:
            lines += wrapped(self._view.silence, width, style="bold red")
        if status["stale"]:
            lines += wrapped(f"STALE: as it was {status['age_s']:.0f} s ago", width, style="bold red")
        if line.cell_len + len(title) + 2 <= width:
            line.append(" " * (width - line.cell_len - len(title) - 1) + title)
        else:
            lines += wrapped(title, width)
        if load["open"] is False and status["state"] in ("harvesting", "sweeping"):
            lines += wrapped("no load is open: grain counts only in the total; l, n starts one", width, style="bold yellow")
        if status["zero_waits_for"]:
            lines += wrapped(f"waits for {self._units.in_text(status['zero_waits_for'])}", width, style="yellow")
        return lines

    def _large(self, width: int, *, plain: bool) -> list[Text]:
        now, units = self._status["now"], self._units
        flow = (now["mass_flow_kg_s"], units.flow_unit, f"flow, {(now['quality'] or UNKNOWN).replace('_', ' ')}")
        figures = [flow, (now["yield_kg_m2"], units.yield_unit, "yield")]
        column = width // 2
        titles, pieces = Text(" "), [Text(" "), Text(" "), Text(" ")]
        for value, unit, name in figures:
            digits = large(_figure(value, unit), plain=plain)
            titles.append(f"{name}, {unit.name}".ljust(column))
            for line, piece in zip(pieces, digits, strict=True):
                line.append(piece.ljust(column), style="bold green" if value is not None else "bold yellow")
        return [titles, *pieces]

    def _figures(self, width: int) -> list[Text]:
        status, units = self._status, self._units
        load, now, sweep, crop = status["load"], status["now"], status["sweep"], status["crop"]
        wet = units.mass_with_bushels(load["mass_kg"])
        around = f" ± {units.mass(load['std_dev_kg'])}" if load["std_dev_kg"] is not None else ""
        known = load["dry_mass_kg"] is not None
        missing = ", moisture missing" if status["total"].get("mass_of_unknown_moisture_kg") else ""
        dry = units.mass_with_bushels(load["dry_mass_kg"]) if known else f"not known{missing}"
        angle = _one(now["plate_angle_deg"])
        market = crop["market_moisture_pct"]
        rows = [
            ("load", f"{wet}{around}", "dry", dry + (f" at {market:g} %" if known and market is not None else "")),
            ("area", units.area(load["area_m2"]), "yield", self._yields()),
            ("total", units.mass(status["total"]["mass_kg"]), "speed", units.speed(now["ground_speed_m_s"])),
            ("grain", f"moisture {moisture(now['moisture_pct'])}", "plate", f"{angle} deg, {_sweep(sweep)}"),
        ]
        needed, right = (max(len(row[part]) for row in rows) for part in (1, 3))
        left = max(needed, min(width // 2 - 9, width - _BESIDE - right))
        lines = []
        for first, value, second, other in rows:
            if _BESIDE + needed + right <= width:
                lines.append(Text(f" {first:<6} {value:<{left}} {second:<6} {other}", no_wrap=True))
            else:
                lines += [*wrapped(f"{first:<6} {value}", width), *wrapped(f"{second:<6} {other}", width)]
        return lines

    def _yields(self) -> str:
        load, units = self._status["load"], self._units
        if load["yield_kg_m2"] is None:
            return UNKNOWN
        dry = load["dry_yield_kg_m2"]
        return f"{units.crop_yield(load['yield_kg_m2'])} wet" + (f", {units.crop_yield(dry)} dry" if dry is not None else "")

    def _faults(self, width: int, room: int) -> list[Text]:
        """Each fault with its remedy; where there is no room for all, the last line counts those that are left out."""
        faults = self._status["faults"]
        if not faults:
            return [Text("" if self._status["state"] in (NO_MONITOR, WAITS) else " no faults", style="green")]
        paragraphs = []
        for fault in faults:
            detail = f" ({self._units.in_text(fault['detail'])})" if fault["detail"] else ""
            paragraphs.append(wrapped(f"{fault['code']}{detail}: {fault['effect']} {fault['remedy']}", width))
            paragraphs[-1][0].highlight_words([fault["code"]], "bold red")
        for shown in range(len(faults), -1, -1):
            names = ", ".join(fault["code"] for fault in faults[shown:])
            rest = wrapped(f"also {names}; `yieldmon status` has all", width, style="bold red") if names else []
            lines = [line for one in paragraphs[:shown] for line in one] + rest
            if len(lines) <= room:
                break
        return lines

    def _foot(self, width: int, *, plain: bool) -> list[Text]:
        return [rule(width, plain=plain), *self._asked(width), *wrapped(KEYS, width, hanging=" ", style="dim")]

    def _asked(self, width: int) -> list[Text]:
        lines = wrapped(self._prompt, width, style="bold") if self._prompt else []
        return [*lines, Text(" PAUSED", style="bold yellow")] if self._view.paused else lines


def from_frames(traffic: Traffic, absent: str = NO_MONITOR) -> Status:
    """What frames report of a monitor on the bus, as a daemon's status; its state is `absent` where they report none."""
    mass, state = (traffic.latest(name) for name in (ACCUMULATED_MASS, YIELD_MONITOR_STATUS))
    flow, calibration = (traffic.fresh(name) for name in (MASS_FLOW, SELF_CALIBRATION_STATUS))
    plate, grain, moving = (traffic.fresh(name) for name in (PLATE_ACTUATOR_FEEDBACK, GRAIN_CONDITION, VEHICLE_DIRECTION_SPEED))
    silent_s = traffic.overdue_s(YIELD_MONITOR_STATUS)

    def signal(frame: Any, name: str) -> float | None:
        value: Value | None = frame.signals[name] if frame is not None else None
        return float(value) if isinstance(value, int | float) else None

    codes = [code for code in FaultCode if state is not None and state.signals.get(code.value) == 1]
    number, operating = signal(mass, "LoadNumber"), signal(state, "OperatingState")
    speed_km_h = signal(moving, "NavigationSpeed")
    return {
        "state": absent if operating is None else OperatingState(int(operating)).name.lower(),
        "stale": silent_s is not None,
        "age_s": silent_s or 0.0,
        "zero_waits_for": None,
        "crop": {"name": "", "bushel_kg": None, "market_moisture_pct": None},
        "now": {
            "mass_flow_kg_s": signal(flow, "MassFlowRate"),
            "std_dev_kg_s": signal(flow, "MassFlowStdDev"),
            "quality": values.code_name("EstimateQuality", flow.signals["EstimateQuality"]) if flow is not None else None,
            "yield_kg_m2": None,
            "moisture_pct": signal(grain, "Moisture"),
            "ground_speed_m_s": None if speed_km_h is None else speed_km_h * M_S_PER_KMH,
            "plate_angle_deg": signal(plate, "PlateAngle"),
        },
        "load": {
            "number": None if number is None else int(number), "open": None, "field": "", "crop": "",
            "mass_kg": signal(mass, "LoadMass"), "std_dev_kg": None, "dry_mass_kg": None, "area_m2": None,
            "yield_kg_m2": None, "dry_yield_kg_m2": None,
        },
        "total": {"mass_kg": signal(mass, "TotalMass")},
        "sweep": {
            "state": values.code_name("SweepState", calibration.signals["SweepState"]) if calibration is not None else UNKNOWN,
            "progress_pct": signal(calibration, "SweepProgress") or 0.0,
            "due_in_s": None,
        },
        "faults": [
            {"code": code.value, "detail": "", "effect": FAULTS[code].effect, "remedy": FAULTS[code].remedy} for code in codes
        ],
    }  # fmt: skip


def _figure(value: float | None, unit: Unit) -> str:
    if value is None:
        return "--.-"
    shown = unit.of(value)
    return f"{shown:.1f}" if shown < 99.95 else f"{shown:,.0f}"


def _one(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.1f}"


def _sweep(sweep: Mapping[str, Any]) -> str:
    state = sweep["state"].replace("_", " ")
    if sweep["progress_pct"]:
        return f"sweep {state} {sweep['progress_pct']:.0f} %"
    due = sweep["due_in_s"] if state != "waiting" else None
    return f"sweep {state}" + (f", next in {due / 60.0:.0f} min" if due else "")
