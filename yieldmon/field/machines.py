"""Delays of each machine of a harvest: two combines in one field, or two fields' files, need not have the same.

A machine whose own passes decide nothing takes the delay of its other files, where those agree; else it keeps its default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .delay import Decision, Delay, estimate_delay, given_delay
from .pairs import Pairs, opposing_pairs
from .placed import Placed, measured_mass_kg, place
from .table import Array, HarvestTable, Index, Source
from .tracks import Tracks

MAX_MACHINES = 200
"""With more, names of machines are no names; all rows are then taken as of one."""


@dataclass(frozen=True)
class Machine:
    """A machine of one source.

    Parameters
    ----------
    name : str
        Of source and machine, for people; empty where there is one machine only.
    stream : int
        As in Tracks; -1 where all rows are taken as one.
    rows : array of int
        Of the table.
    flow, moisture : Delay
        Its delays.
    """

    name: str
    stream: int
    rows: Index
    flow: Delay
    moisture: Delay


@dataclass(frozen=True)
class _Part:
    stream: int
    rows: Index
    steps: Tracks
    pairs: Pairs
    source: Source
    machine: str


def machines_of(
    table: HarvestTable, steps: Tracks, pairs: Pairs, given_flow_s: float | None, given_moisture_s: float | None, seed: int
) -> tuple[Machine, ...]:
    """The machines with their delays, the one that measured most first.

    Parameters
    ----------
    table, steps, pairs
        A harvest, its tracks, and its pairs of opposing passes.
    given_flow_s, given_moisture_s : float or None
        By a person, for all machines.
    seed : int
        Of the draws for intervals.
    """
    parts = _parts(table, steps, pairs)
    flow = _delays(
        parts,
        steps,
        "flow",
        given_flow_s,
        [(part.source.default_flow_s, part.source.declared_flow_s) for part in parts],
        [seed, 0],
    )
    moisture = _delays(
        parts,
        steps,
        "moisture",
        given_moisture_s,
        [(one.value_s, None) for one in flow],
        [seed, 1],
    )
    mass = measured_mass_kg(table)
    found = [
        Machine(_name(part) if len(parts) > 1 else "", part.stream, part.rows, one, other)
        for part, one, other in zip(parts, flow, moisture, strict=True)
    ]
    return tuple(sorted(found, key=lambda machine: -float(mass[machine.rows].sum())))


def _name(part: _Part) -> str:
    return f"{Path(part.source.path).name}{', machine ' + part.machine if part.machine else ''}"


def _parts(table: HarvestTable, steps: Tracks, pairs: Pairs) -> list[_Part]:
    streams = np.unique(steps.stream)
    label = table.labels["machine"]
    if len(streams) < 2 or len(streams) > MAX_MACHINES:
        first = replace(
            table.sources[0],
            default_flow_s=table.default_flow_s,
            declared_flow_s=table.declared_flow_s,
        )
        return [_Part(-1, np.arange(len(table)), steps, pairs, first, "")]
    out = []
    for stream in streams.tolist():
        rows = np.flatnonzero(steps.stream[steps.step_of_row] == stream)
        own = steps.of_rows(rows)
        source, machine = divmod(stream, len(label.names))
        out.append(_Part(stream, rows, own, opposing_pairs(own), table.sources[source], label.names[machine]))
    return out


def _delays(
    parts: Sequence[_Part],
    steps: Tracks,
    quantity: str,
    given_s: float | None,
    known_s: Sequence[tuple[float, float | None]],
    seed: list[int],
) -> list[Delay]:
    """known_s: default and declared delay of each part."""

    def estimated(of: Tracks, pairs: Pairs, default_s: float, declared_s: float | None) -> Delay:
        start_s = default_s if declared_s is None else declared_s
        generator = np.random.default_rng(seed)
        return estimate_delay(of, pairs, quantity, default_s=start_s, declared_s=declared_s, generator=generator)

    own = [estimated(part.steps, part.pairs, *known) for part, known in zip(parts, known_s, strict=True)]
    own = [_as_said(one, part.source) for one, part in zip(own, parts, strict=True)]
    if given_s is not None:
        return [given_delay(given_s, known[1], one) for one, known in zip(own, known_s, strict=True)]
    for members in _same_machine(parts):
        unsure = [k for k in members if own[k].decision is Decision.CANNOT_TELL]
        if len(members) < 2 or not unsure or not _agree([own[k] for k in members if k not in unsure]):
            continue
        rows = np.sort(np.concatenate([parts[k].rows for k in members]))
        together = steps.of_rows(rows)
        pooled = estimated(together, _within(together, opposing_pairs(together)), *known_s[unsure[0]])
        if pooled.decision is Decision.ESTIMATED:
            for k in unsure:
                own[k] = replace(pooled, declared_s=known_s[k][1], why=f"one clear peak in {len(members)} files together")
    return own


def _as_said(estimate: Delay, source: Source) -> Delay:
    """No shift where the source says that the delay was taken out, and the data do not say otherwise."""
    low, high = estimate.low_s, estimate.high_s
    if not source.taken_out or low is None or high is None or not low <= 0.0 <= high:
        return estimate
    return replace(
        estimate, value_s=0.0, shifted=estimate.no_shift, why="taken out before, as the source says, and no other peak"
    )


def _same_machine(parts: Sequence[_Part]) -> list[list[int]]:
    """Parts by kind of source and name of machine."""
    groups: dict[tuple[str, str], list[int]] = {}
    for k, part in enumerate(parts):
        groups.setdefault((part.source.kind, part.machine), []).append(k)
    return list(groups.values())


def _agree(estimates: Sequence[Delay]) -> bool:
    """Whether all intervals share a delay."""
    lows = [one.low_s for one in estimates if one.low_s is not None]
    highs = [one.high_s for one in estimates if one.high_s is not None]
    return not lows or max(lows) <= min(highs)


def _within(steps: Tracks, pairs: Pairs) -> Pairs:
    """The pairs of which both passes are of one stream."""
    same = steps.stream[pairs.first] == steps.stream[pairs.second]
    names, block = np.unique(pairs.block[same], return_inverse=True)
    return Pairs(pairs.first[same], pairs.second[same], block.astype(np.intp), len(names))


def placed_by_machine(table: HarvestTable, steps: Tracks, machines: Sequence[Machine], factor: Array | None) -> Placed:
    """Mass and moisture at the places, each machine's by its own delays. factor: as for `place`."""
    if len(machines) == 1:
        return place(table, steps, machines[0].flow.value_s, machines[0].moisture.value_s, factor)
    count = len(table)
    measured, mass, moisture, sd = np.zeros(count), np.full(count, np.nan), np.full(count, np.nan), np.full(count, np.nan)
    from_row = np.full(count, -1, np.intp)
    lost_kg = 0.0
    for machine in machines:
        rows = machine.rows
        part = place(
            table.take(rows),
            steps.of_rows(rows),
            machine.flow.value_s,
            machine.moisture.value_s,
            None if factor is None else factor[rows],
        )
        measured[rows], mass[rows], moisture[rows], sd[rows] = (
            part.measured_kg,
            part.mass_kg,
            part.moisture_pct,
            part.flow_sd_kg_s,
        )
        from_row[rows] = np.where(part.from_row >= 0, rows[part.from_row], -1)
        lost_kg += part.lost_kg
    return Placed(measured, mass, moisture, sd, from_row, lost_kg)
