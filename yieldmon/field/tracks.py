"""What the machine did, from the rows: steps in time, headings, stretches with the header down.

A step is one time of one machine. Where a source has a row for each section of the header, a step takes them together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from .groups import by_time, mean_known, step_begins, total_known
from .leaps import bridged
from .plane import Sites
from .table import Array, Flags, HarvestTable, Index

MIN_SPEED_M_S = 0.3
"""Below it a yield is not defined and a heading is noise."""
_HEADING_SPAN = 2
_USUAL_ROWS = 41
"""About a row, of which the median step is the usual one."""
GAP_INTERVALS = 3.0
"""So many usual intervals without a step are a gap."""
EMPTY_SHARE = 0.05
"""Of a machine's median flow; below it the machine runs empty: a sensor's zero drifts, and grain trickles after a pass."""
_MOMENTS_S = 4.0
"""From one known flow to the next, for which grain goes on: shorter than a turn."""
FAR_S = 10_000.0
"""Between times that are to be far apart: those of two streams on one axis, and those that are not known."""


@dataclass(frozen=True)
class Tracks:
    """Steps in order of stream and time; `step_of_row` leads from a table's rows to them.

    Parameters
    ----------
    plane : Sites
        On which x_m and y_m are.
    step_of_row : array of int, shape (n,)
        Of each of the table's rows.
    row_x_m, row_y_m : array, shape (n,)
        Place of each of them.
    stream : array of int, shape (k,)
        One machine of one source; time is continuous within a stream only.
    time_s, x_m, y_m, speed_m_s, width_m, flow_kg_s, moisture_pct, interval_s : array, shape (k,)
        Of a step; flow and width are the sum of the sections, position and moisture their mean.
    heading_rad : array, shape (k,)
        Clockwise from north, from positions; NaN while standing.
    down : array of bool, shape (k,)
        Harvesting: header down, or more than EMPTY_SHARE of the usual flow while driving where the source does not say.
    run : array of int, shape (k,)
        Number of the stretch without a gap in time.
    pass_number : array of int, shape (k,)
        Number of the stretch with the header down, -1 with it up.
    usual_interval_s : float
        Median time between steps.
    """

    plane: Sites
    step_of_row: Index
    row_x_m: Array
    row_y_m: Array
    stream: Index
    time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array
    speed_m_s: Array
    width_m: Array
    flow_kg_s: Array
    moisture_pct: Array
    interval_s: Array
    down: Flags
    run: Index
    pass_number: Index
    usual_interval_s: float

    def __len__(self) -> int:
        return len(self.time_s)

    def of_rows(self, rows: Index) -> Tracks:
        """The steps of some of the table's rows, as of a table of only these."""
        step = self.step_of_row[rows]
        chosen = np.zeros(len(self), bool)
        chosen[step] = True
        number = np.cumsum(chosen) - 1
        arrays = {
            name: getattr(self, name)[chosen]
            for name in (
                "stream",
                "time_s",
                "x_m",
                "y_m",
                "heading_rad",
                "speed_m_s",
                "width_m",
                "flow_kg_s",
                "moisture_pct",
                "interval_s",
                "down",
                "run",
                "pass_number",
            )
        }
        return replace(
            self,
            step_of_row=number[step],
            row_x_m=self.row_x_m[rows],
            row_y_m=self.row_y_m[rows],
            usual_interval_s=_interval(arrays["time_s"], arrays["stream"]),
            **arrays,
        )

    def run_ends(self) -> tuple[Index, Index]:
        """The first and the last step of each run, each of shape (runs,)."""
        first = np.flatnonzero(np.diff(self.run, prepend=-1))
        return first, np.append(first[1:], len(self)) - 1

    def nearest(self, time_s: Array, stream: Index, tolerance_s: float) -> Index:
        """The step of a stream next to each time, -1 where none is within the tolerance."""
        if not len(self):
            return np.zeros(len(time_s), np.intp)
        span = float(self.time_s.max() - self.time_s.min()) + FAR_S
        keys = self.stream * span + (self.time_s - self.time_s.min())
        wanted = stream * span + (time_s - self.time_s.min())
        right = np.clip(np.searchsorted(keys, wanted), 1, max(len(keys) - 1, 1)) if len(keys) > 1 else np.ones(len(wanted), int)
        if len(keys) == 1:
            return np.where(np.abs(wanted - keys[0]) <= tolerance_s, 0, -1)
        left = right - 1
        chosen = np.where(wanted - keys[left] <= keys[right] - wanted, left, right)
        # Of steps at the same time the first is meant.
        chosen = np.searchsorted(keys, keys[chosen])
        return np.where(np.abs(keys[chosen] - wanted) <= tolerance_s, chosen, -1)

    def holding(self, time_s: Array, stream: Index) -> Index:
        """The step of a stream in whose interval, which ends with it, each time lies; -1 where there is none."""
        if not len(self):
            return np.full(len(time_s), -1, np.intp)
        begun_s = float(self.time_s.min())
        span = float(self.time_s.max()) - begun_s + float(np.ptp(time_s) if len(time_s) else 0.0) + FAR_S
        keys = self.stream * span + (self.time_s - begun_s)
        wanted = stream * span + (time_s - begun_s)
        found = np.minimum(np.searchsorted(keys, wanted), len(self) - 1)
        left_s = keys[found] - wanted
        return np.where((left_s >= 0.0) & (left_s < self.interval_s[found]), found, -1)


def tracks(table: HarvestTable) -> Tracks:
    """The steps of a table. Rows without time or position are steps of no place."""
    plane = Sites.about(table["longitude_deg"], table["latitude_deg"])
    x, y = plane.to_m(table["longitude_deg"], table["latitude_deg"])
    time = _spread_unknown(table["time_s"])
    rows = _StepRows.of(table, time)
    step_time, step_stream = time[rows.first], table.stream[rows.first]
    interval_s = np.nan_to_num(rows.mean(table["interval_s"]))
    step_x, step_y = rows.mean(x), rows.mean(y)
    run = _runs(step_time, step_stream)
    distance = rows.mean(table["distance_m"])
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.where(interval_s > 0, distance / interval_s, np.nan)
    flow = rows.total(table["flow_kg_s"])
    header = rows.mean(table["header_down"])
    driving = np.nan_to_num(speed) > MIN_SPEED_M_S
    down = np.where(np.isfinite(header), header > 0, driving & running(flow, step_stream, step_time)) & np.isfinite(step_x)
    return Tracks(
        plane=plane,
        step_of_row=rows.step_of_row,
        row_x_m=x,
        row_y_m=y,
        stream=step_stream,
        time_s=step_time,
        x_m=step_x,
        y_m=step_y,
        heading_rad=_headings(*bridged(step_x, step_y, step_time, run), run, driving),
        speed_m_s=speed,
        width_m=rows.total(np.nan_to_num(table["width_m"])),
        flow_kg_s=flow,
        moisture_pct=rows.mean(table["moisture_pct"]),
        interval_s=interval_s,
        down=down,
        run=run,
        pass_number=_passes(down, run),
        usual_interval_s=_interval(step_time, step_stream),
    )


@dataclass(frozen=True)
class _StepRows:
    """Which rows are which step.

    Parameters
    ----------
    step_of_row : array of int, shape (n,)
        Number of each row's step, in the order of stream and time.
    first : array of int, shape (k,)
        First row of each step.
    """

    step_of_row: Index
    first: Index

    @classmethod
    def of(cls, table: HarvestTable, time_s: Array) -> _StepRows:
        """Of a table whose unknown times are far from all others in time_s."""
        order = by_time(time_s, table.stream)
        if np.nan_to_num(table["section"]).any():
            begins = step_begins(time_s[order], table.stream[order])
        else:
            begins = np.ones(len(table), bool)
        step_of_row = np.empty(len(table), np.intp)
        step_of_row[order] = np.cumsum(begins) - 1
        return cls(step_of_row, order[begins])

    def mean(self, values: Array) -> Array:
        """Mean of the known values of each step; NaN where none is known."""
        return self._of_steps(values, mean_known)

    def total(self, values: Array) -> Array:
        """Sum of the known values of each step; NaN where none is known."""
        return self._of_steps(values, total_known)

    def _of_steps(self, values: Array, summed: Callable[[Array, Index, int], Array]) -> Array:
        if len(self.first) == len(self.step_of_row):
            return values[self.first]
        return summed(values, self.step_of_row, len(self.first))


def _runs(time_s: Array, stream: Index) -> Index:
    """Number of the stretch without a gap in time of each step."""
    gap = np.diff(time_s)
    starts = np.diff(stream, prepend=-1) != 0
    usual_s = usual_steps(np.diff(time_s, prepend=np.nan), starts)
    breaks = (np.diff(stream) != 0) | (gap > GAP_INTERVALS * np.maximum(usual_s[1:], 1e-3)) | ~np.isfinite(gap)
    return np.cumsum(np.r_[False, breaks])[: len(time_s)]


def _passes(down: Flags, run: Index) -> Index:
    """Number of the stretch with the header down of each step, -1 with it up."""
    started = down & np.r_[True, ~down[:-1] | (np.diff(run) != 0)][: len(down)]
    return np.where(down, np.cumsum(started) - 1, -1)


def cut_before_measured(steps: Tracks, table: HarvestTable, delays_s: Mapping[int, float]) -> Tracks:
    """The steps of which the source does not say whether the header was down, harvesting where their grain was measured later.

    Parameters
    ----------
    steps : Tracks
        Of the table; with the header down where there was flow at the same time.
    table : HarvestTable
    delays_s : mapping of int to float
        Stream -> delay from cutting to the sensor; -1 for all.
    """
    said = np.zeros(len(steps), bool)
    said[steps.step_of_row[np.isfinite(table["header_down"])]] = True
    down = steps.down.copy()
    grain_flows = running(steps.flow_kg_s, steps.stream, steps.time_s)
    for stream, delay_s in delays_s.items():
        mine = np.flatnonzero(~said & ((steps.stream == stream) | (stream < 0)))
        if abs(delay_s) < steps.usual_interval_s or not mine.size:
            continue
        later = steps.nearest(steps.time_s[mine] + delay_s, steps.stream[mine], 0.75 * steps.usual_interval_s)
        grain = (later >= 0) & grain_flows[later]
        down[mine] = grain & (np.nan_to_num(steps.speed_m_s[mine]) > MIN_SPEED_M_S) & np.isfinite(steps.x_m[mine])
    return replace(steps, down=down, pass_number=_passes(down, steps.run))


def running(flow_kg_s: Array, stream: Index, time_s: Array) -> Flags:
    """Where each machine has more than EMPTY_SHARE of its own median flow, or a flow that is not known for moments between such.

    >>> running(np.array([0.0, 0.1, 8.0, np.nan, 9.0, np.nan, 0.1]), np.array([0, 0, 0, 0, 0, 0, 1]), np.arange(7.0)).tolist()
    [False, False, True, True, True, False, True]
    """
    flow = np.nan_to_num(flow_kg_s)
    machines, number = np.unique(stream, return_inverse=True)
    grain = np.flatnonzero(flow > 0)
    order = grain[np.lexsort((flow[grain], number[grain]))]
    count = np.bincount(number[grain], minlength=len(machines))
    usual = np.zeros(len(machines))
    some = count > 0
    usual[some] = flow[order[(np.cumsum(count) - count + count // 2)[some]]]
    grain_flows = np.asarray(flow > EMPTY_SHARE * usual[number]) & (flow > 0)
    known = np.flatnonzero(np.isfinite(flow_kg_s))
    lacking = np.flatnonzero(~np.isfinite(flow_kg_s))
    right = np.searchsorted(known, lacking)
    inside = (right > 0) & (right < known.size)
    lacking, before, after = lacking[inside], known[right[inside] - 1], known[right[inside]]
    moments = (number[before] == number[after]) & (time_s[after] - time_s[before] <= _MOMENTS_S)
    grain_flows[lacking] = moments & grain_flows[before] & grain_flows[after]
    return grain_flows


def _interval(time_s: Array, stream: Index) -> float:
    """Median time from step to step of the same stream, s."""
    gap = np.diff(time_s)
    positive = gap[(gap > 0) & (np.diff(stream) == 0)]
    return float(np.median(positive)) if positive.size else 1.0


def usual_steps(step_s: Array, begins: Flags) -> Array:
    """The usual step about each row: a log may change its rate, and a longer step within a rate is a gap.

    Parameters
    ----------
    step_s : array, shape (n,)
        Time since the row before, in order of stream and time.
    begins : array of bool, shape (n,)
        Rows that begin a stream.

    Returns
    -------
    array, shape (n,)
        Median of the positive steps among the 41 nearest of the same stream, s; 1 where a stream has none.

    Examples
    --------
    >>> usual_steps(np.r_[np.nan, np.ones(50), 60.0, np.full(50, 5.0)], np.arange(102) == 0)[[0, 10, 51, 101]].tolist()
    [1.0, 1.0, 5.0, 5.0]
    """
    out = np.ones(len(step_s))
    first = np.flatnonzero(begins | (np.arange(len(step_s)) == 0))
    for begin, end in zip(first.tolist(), [*first[1:].tolist(), len(step_s)], strict=True):
        own = step_s[begin + 1 : end]
        positive = np.flatnonzero(own > 0)
        if positive.size:
            usual = median_filter(own[positive], min(_USUAL_ROWS, 2 * positive.size - 1), mode="mirror")
            nearest = np.searchsorted(positive, np.arange(end - begin) - 1).clip(0, positive.size - 1)
            out[begin:end] = usual[nearest]
    return out


def _spread_unknown(time_s: Array) -> Array:
    """Times, with each that is not known far from all others."""
    known = np.isfinite(time_s)
    if known.all():
        return time_s
    last = float(time_s[known].max()) if known.any() else 0.0
    return np.where(known, time_s, last + FAR_S * (1.0 + np.cumsum(~known)))


def _headings(x: Array, y: Array, run: Index, driving: Flags) -> Array:
    """From the displacement over a few steps to either side, within a run."""
    count = len(x)
    index = np.arange(count)
    if not count:
        return np.zeros(0)
    starts = np.searchsorted(run, run)
    ends = np.searchsorted(run, run, side="right") - 1
    before, after = np.maximum(index - _HEADING_SPAN, starts), np.minimum(index + _HEADING_SPAN, ends)
    dx, dy = x[after] - x[before], y[after] - y[before]
    heading = np.arctan2(dx, dy)
    return np.where(driving & (np.hypot(dx, dy) > 0), heading, np.nan)


def row_headings(table: HarvestTable, steps: Tracks) -> Array:
    """Heading of each row, rad: while the machine stands the last one, else as the source has it; NaN where none is known."""
    heading = _filled(steps.heading_rad, steps.run)[steps.step_of_row]
    return np.where(np.isfinite(heading), heading, np.radians(table["heading_deg"]))


def _filled(heading: Array, run: Index) -> Array:
    """The last heading known within a run goes on while the machine stands; before the first, the first."""
    out = heading.copy()
    for step in (1, -1):
        values, runs = out[::step], run[::step]
        place = np.where(np.isfinite(values), np.arange(len(values)), -1)
        last = np.maximum.accumulate(place) if len(place) else place
        usable = (last >= 0) & (runs[np.maximum(last, 0)] == runs)
        out = np.where(usable, values[np.maximum(last, 0)], values)[::step]
    return out
