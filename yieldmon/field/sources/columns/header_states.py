"""What a file says of the header: words and numbers for down and up, and whether the grain agrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.field.table import Array, Flags, HarvestTable, Label
from yieldmon.field.tracks import running, tracks

from .delimited import number

_WORDS = dict.fromkeys(
    ("on", "down", "true", "yes", "y", "working", "work", "in work", "harvesting", "harvest", "active", "engaged", "lowered",
     "recording", "header down", "header on", "an", "ein", "ja", "j", "wahr", "aktiv", "unten", "abgesenkt", "arbeitet",
     "in arbeit", "ernte", "si", "sí", "sì", "sim", "oui", "vrai", "verdadero", "verdadeiro", "vero", "abajo", "bajo", "bajado",
     "bajada", "bas", "en bas", "abaissé", "abaissée", "baissé", "baissée", "abaixado", "abaixada", "ligado", "encendido",
     "activo", "ativo", "cosechando", "trabajando", "colhendo", "tak", "omlaag"),
    1.0,
) | dict.fromkeys(
    ("off", "up", "false", "no", "n", "not working", "not in work", "out of work", "not harvesting", "raised", "inactive",
     "disengaged", "transport", "not recording", "paused", "header up", "header off", "aus", "nein", "falsch", "inaktiv", "oben",
     "angehoben", "ausgehoben", "nicht in arbeit", "não", "nao", "non", "faux", "falso", "arriba", "alto", "levantado",
     "levantada", "haut", "en haut", "relevé", "relevée", "levé", "levée", "desligado", "apagado", "inactivo", "inativo", "nie",
     "omhoog"),
    0.0,
)  # fmt: skip
"""What files call a header that is at work, or not."""
_MOST_STATES = 8
"""Different numbers that a state has at most; more are a height."""
_LEAST_ROWS, _MOST_UP = 30, 0.9
"""Rows that tell, and share of the grain that no machine measures with its header up, even if much of it is on its way then."""

_TURN_S, _TURN_DEG, _LEAST_TURNS = 40.0, 150.0, 5
"""A machine turns back within so many seconds; so many times tell."""
_EMPTY_S = 3.0
"""Seconds without grain for each turn."""


def down_of(state: Array, name: str) -> tuple[Array, tuple[str, ...]]:
    """1 for any number but 0, and a note on numbers that are no states.

    Where there is no 0, odd numbers are down and even ones up, as 33 and 32 of Ag Leader's.
    """
    known = np.isfinite(state)
    different = len(np.unique(state[known]))
    if different > _MOST_STATES:
        note = f"{name} holds {different} different numbers, so it is not a header state: it is not used"
        return np.full(len(state), np.nan), (note,)
    with np.errstate(invalid="ignore"):
        odd = np.mod(state, 2) >= 1
    coded = known.any() and (state[known] > 0).all() and odd[known].any() and not odd[known].all()
    return np.where(known, (odd if coded else state > 0).astype(float), np.nan), ()


def states_of(label: Label, name: str) -> tuple[Array, tuple[str, ...]]:
    """1 for on, 0 for off, NaN for a word that is not known, and a note on those."""
    states, unknown = [], []
    for word in label.names:
        state = _WORDS.get(word.lower())
        if state is None:
            try:
                state = number(word)
            except ValueError:
                state = float("nan")
                unknown.append(word)
        states.append(state)
    note = f"{name}: {', '.join(unknown[:5])} is neither on nor off and counts as unknown"
    return np.array(states)[label.codes], (note,) if unknown else ()


def without_contradicted_states(table: HarvestTable) -> HarvestTable:
    """The table without the header states of sources whose grain contradicts them; they say so.

    Those measured most of their grain with the header up, or turned back and ran empty with the header never up.
    """
    header = table["header_down"].copy()
    sources = list(table.sources)
    mass_kg = np.nan_to_num(table["flow_kg_s"] * table["interval_s"])
    for place, source in enumerate(sources):
        mine = (table.source_of_row == place) & np.isfinite(header)
        up = mass_kg[mine & (header == 0)].sum() / max(mass_kg[mine].sum(), 1e-9)
        if mine.sum() >= _LEAST_ROWS and up > _MOST_UP:
            note = f"{100 * up:.0f} % of the grain is measured while the header status is up: the status is not used"
        elif mine.any() and header[mine].all() and (turns := _turns_with_header_down(table, mine)):
            note = f"the header status is down in all {turns} turns, where no grain comes: the status is not used"
        else:
            continue
        sources[place] = replace(source, notes=(*source.notes, note))
        header[mine] = np.nan
    if tuple(sources) == table.sources:
        return table
    return replace(table.with_columns(header_down=header), sources=tuple(sources))


def _turns_with_header_down(table: HarvestTable, mine: Flags) -> int:
    """How often the machine turned back, where it also ran empty about as often; 0 for a few times."""
    steps = tracks(table.take(mine))
    span = max(1, round(_TURN_S / steps.usual_interval_s))
    if len(steps) <= span:
        return 0
    with np.errstate(invalid="ignore"):
        back = np.cos(steps.heading_rad[span:] - steps.heading_rad[:-span]) < np.cos(np.radians(_TURN_DEG))
    back &= steps.run[span:] == steps.run[:-span]
    turns = int(np.count_nonzero(back & ~np.r_[False, back[:-1]]))
    empty_s = float(steps.interval_s[~running(steps.flow_kg_s, steps.stream, steps.time_s)].sum())
    return turns if turns >= _LEAST_TURNS and empty_s >= _EMPTY_S * turns else 0
