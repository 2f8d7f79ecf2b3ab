"""Loads of an earlier run as references: which count as whole, which rest on a doubted zero, and the budget of their mass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.service.test_remeasuring import MACHINE, known, rows
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.settings import EngineSettings
from yieldmon.files import parameter_file
from yieldmon.frames import EstimateQuality
from yieldmon.service.history.reference_loads import StoredLoad, of_store, reference
from yieldmon.service.storage.batch import Action, Load, ParameterVersion
from yieldmon.service.storage.rows import SecondRow

SETTINGS = replace(EngineSettings(), windows=replace(EngineSettings().windows, min_coverage=0.75))
MASS_KG = 50.0
LOAD = Load(number=4, field="", crop="", started_s=99.0, ended_s=104.0, mass_kg=MASS_KG, dry_mass_kg=40.0, area_m2=None)
SECONDS = tuple(rows(4, 100.0))
"""Five of 10 kg, numbers 1 to 5, from 99 s on."""


def whole(changes: dict[int, dict[str, Any]] | None = None, doubted: bool = False, **of_load: Any) -> bool:
    seconds = tuple(replace(row, **(changes or {}).get(row.number, {})) for row in SECONDS)
    stored = StoredLoad(replace(LOAD, **of_load), seconds, {1: known()}, doubted)
    return reference(stored, MACHINE, SETTINGS).summary.complete


NOT_MEASURED = {"mass_flow_kg_s": None, "quality": int(EstimateQuality.NOT_AVAILABLE)}
SILENT = NOT_MEASURED | {"coverage": 0.0, "elevator_speed_rpm": None, "mass_kg": 0.0}
NOT_HARVESTING = {"mass_flow_kg_s": None, "quality": int(EstimateQuality.NOT_HARVESTING)}
AT_REST = NOT_HARVESTING | {"elevator_speed_rpm": 0.0, "mass_kg": 0.0}


@pytest.mark.parametrize(
    ("changes", "of_load", "expected"),
    [
        ({}, {}, True),
        ({3: {"coverage": 0.75}}, {}, True),
        ({3: {"coverage": 0.7499}}, {}, False),
        ({3: {"surplus_frames": 1}}, {}, False),
        ({3: NOT_MEASURED}, {}, False),
        ({3: NOT_HARVESTING}, {}, True),
        ({1: SILENT, 2: SILENT}, {"mass_kg": 0.6 * MASS_KG}, True),
        ({1: SILENT, 2: NOT_MEASURED | {"mass_kg": 0.0}}, {"mass_kg": 0.6 * MASS_KG}, True),
        ({1: SILENT | {"elevator_speed_rpm": 0.0}}, {"mass_kg": 0.8 * MASS_KG}, True),
        ({1: SILENT | {"elevator_speed_rpm": 1.0}}, {"mass_kg": 0.8 * MASS_KG}, False),
        ({1: SILENT | {"coverage": 0.1}}, {"mass_kg": 0.8 * MASS_KG}, False),
        # Too few samples for a flow, and what was measured counts.
        ({1: SILENT, 2: NOT_MEASURED | {"coverage": 0.1}}, {"mass_kg": 0.8 * MASS_KG}, False),
        ({2: SILENT}, {"mass_kg": 0.8 * MASS_KG}, False),
        ({3: NOT_HARVESTING | {"coverage": 0.0, "surplus_frames": 1}}, {}, True),
        ({}, {"mass_kg": MASS_KG * 1.00009}, True),
        ({}, {"mass_kg": MASS_KG * 1.0002}, False),
        ({}, {"mass_kg": MASS_KG * 0.9998}, False),
        ({}, {"mass_kg": 0.0}, False),
        ({}, {"started_s": 98.5}, True),
        ({}, {"started_s": 98.25}, False),
        ({}, {"started_s": None}, True),
        ({4: {"time_s": 103.25}, 5: {"time_s": 104.5}}, {}, True),
        ({4: {"time_s": 103.25}, 5: {"time_s": 104.75}}, {}, False),
        ({4: {"time_s": 102.5}, 5: {"time_s": 104.0}}, {}, True),
        ({}, {"ended_s": 105.5}, True),
        ({}, {"ended_s": 5000.0}, False),
        ({5: AT_REST}, {"ended_s": 5000.0, "mass_kg": 0.8 * MASS_KG}, True),
        # Computer and ignition were off, while the elevator stood.
        ({3: AT_REST, 4: AT_REST | {"time_s": 4000.0}, 5: {"time_s": 4001.0}}, {"mass_kg": 0.6 * MASS_KG}, True),
        ({3: AT_REST, 4: SILENT, 5: SILENT}, {"mass_kg": 0.4 * MASS_KG}, True),
        ({3: AT_REST, 4: {"time_s": 4000.0}, 5: {"time_s": 4001.0}}, {"mass_kg": 0.8 * MASS_KG}, False),
        ({4: AT_REST | {"time_s": 4000.0}, 5: {"time_s": 4001.0}}, {"mass_kg": 0.8 * MASS_KG}, False),
    ],
)
def test_a_whole_load_has_every_second(changes: dict[int, dict[str, Any]], of_load: dict[str, Any], expected: bool) -> None:
    """At most half a second may lack altogether, and a ten-thousandth of the mass."""
    assert whole(changes, **of_load) is expected
    assert not whole(changes, doubted=True, **of_load)


def test_a_load_as_the_engine_takes_it() -> None:
    found = reference(StoredLoad(LOAD, SECONDS, {1: known()}, False), MACHINE, SETTINGS)
    summary = found.summary
    assert (summary.number, summary.start_s, summary.end_s, summary.measured_kg) == (4, 99.0, 104.0, MASS_KG)
    assert (summary.dry_kg, summary.unknown_moisture_kg, found.versions) == (40.0, 0.0, {1})
    assert len(found.seconds) == 5
    without = reference(
        StoredLoad(replace(LOAD, dry_mass_kg=None, started_s=None), SECONDS, {1: known()}, False), MACHINE, SETTINGS
    )
    assert (without.summary.dry_kg, without.summary.unknown_moisture_kg, without.summary.start_s) == (0.0, MASS_KG, 99.0)


class Kept:
    """What a store holds of this load and of what was entered."""

    path = Path("yieldmon.sqlite")

    def __init__(self, *actions: Action, load: Load = LOAD, versions: tuple[int, ...] = (1,), loads: int = 1) -> None:
        self._actions, self._load, self._versions, self._count = actions, load, versions, loads

    def loads(self) -> list[Load]:
        return [replace(self._load, number=4 + k) for k in range(self._count)]

    def actions(self) -> tuple[Action, ...]:
        return self._actions

    def parameter_versions(self) -> list[ParameterVersion]:
        return [ParameterVersion(v, 0.0, "", parameter_file.to_document(known(v))) for v in self._versions]

    def seconds_of_load(self, number: int) -> list[SecondRow]:
        return list(SECONDS)


def zero(second: int, at_s: float, signs: str = "grain", kind: str = "zero") -> Action:
    return Action(second, at_s, kind, "", {"second": second, "signs": signs} if kind == "zero" else {})


def undone(at_s: float) -> Action:
    return zero(0, at_s, kind="zero-undo")


@pytest.mark.parametrize(
    ("actions", "doubted"),
    [
        ((), False),
        ((zero(3, 102.0),), True),
        ((zero(4, 103.0),), True),
        ((zero(5, 104.0),), False),
        ((zero(0, 50.0),), True),
        ((zero(0, 50.0, signs=""),), False),
        ((zero(3, 102.0), undone(103.0)), True),
        ((zero(1, 100.0), undone(103.0)), True),
        ((zero(4, 103.0), undone(104.0)), True),
        ((zero(5, 104.0), undone(105.0)), False),
        ((zero(0, 50.0), undone(60.0)), False),
        ((zero(0, 50.0), undone(99.0)), False),
        ((zero(0, 50.0), undone(100.0)), True),
        ((zero(0, 50.0), zero(3, 102.0, signs="")), True),
        ((zero(0, 50.0), zero(9, 200.0, signs="")), True),
        ((zero(0, 50.0), zero(0, 60.0), zero(9, 200.0, signs="")), True),
        ((zero(0, 50.0), zero(0, 60.0, signs="")), False),
        ((zero(3, 102.0, signs=""), undone(103.0)), False),
        ((Action(1, 102.0, "ticket", "", {"second": 3, "signs": "grain"}),), False),
    ],
)
def test_a_zero_against_the_signs_of_grain_is_suspect_until_the_next(actions: tuple[Action, ...], doubted: bool) -> None:
    (stored,) = of_store(Kept(*actions), [4])  # type: ignore[arg-type]
    assert stored.doubted is doubted
    assert stored.seconds == SECONDS
    assert stored.parameters[1].values == known().values


def test_which_loads_are_looked_for() -> None:
    """Closed ones whose parameters are still there, and of many numbers the newest 64."""
    assert of_store(Kept(), [5]) == ()  # type: ignore[arg-type]
    assert of_store(Kept(load=replace(LOAD, ended_s=None)), [4]) == ()  # type: ignore[arg-type]
    assert of_store(Kept(versions=(2,)), [4]) == ()  # type: ignore[arg-type]
    (cut,) = of_store(Kept(load=replace(LOAD, ended_s=102.0)), [4])  # type: ignore[arg-type]
    assert [row.number for row in cut.seconds] == [1, 2, 3]
    many = of_store(Kept(loads=70), range(4, 74))  # type: ignore[arg-type]
    assert [stored.load.number for stored in many] == list(range(10, 74))


@pytest.mark.parametrize(
    ("noises", "whole_kg", "noise_kg2"),
    [((0.3, 0.4, 0.0, 0.0, 0.0), 5.0, 0.25), ((0.3, None, 0.0, 0.0, 0.0), 5.0, None), ((0.1,) * 5, None, None)],
)
def test_the_budget_is_the_seconds_noise_and_what_is_left(
    noises: tuple[float | None, ...], whole_kg: float | None, noise_kg2: float | None
) -> None:
    seconds = tuple(
        replace(row, noise_std_dev_kg_s=noise, load_std_dev_kg=whole_kg) for row, noise in zip(SECONDS, noises, strict=True)
    )
    summary = reference(StoredLoad(LOAD, seconds, {1: known()}, False), MACHINE, SETTINGS).summary
    if noise_kg2 is None or whole_kg is None:
        assert repr(summary.budget) == repr(type(summary.budget).unknown())
        return
    budget = summary.budget
    assert budget.noise_kg2 == pytest.approx(noise_kg2)
    assert budget.parameters_kg > 0.0
    assert budget.noise_kg2 + budget.parameters_kg**2 + budget.zero_kg**2 == pytest.approx(
        max(whole_kg**2, noise_kg2 + budget.parameters_kg**2)
    )


def test_a_load_that_was_stored_with_its_budget_has_it_back() -> None:
    """However many loads ago it was: what sweeps may show of the parameters is not taken for the zero's error."""
    stated = MassBudget(noise_kg2=0.25, parameters_kg=3.5, zero_kg=0.2, moisture_kg=0.1, motion_kg=-0.05)
    load = replace(LOAD, std_dev_kg=stated.std_dev_kg, budget=stated)
    summary = reference(StoredLoad(load, SECONDS, {1: known()}, False), MACHINE, SETTINGS).summary
    assert (summary.budget, summary.std_dev_kg) == (stated, stated.std_dev_kg)


def test_the_budget_of_seconds_of_another_length_goes_with_their_length() -> None:
    """Noise and the parameters' share are kg: twice the time at the same flow, twice of each."""

    def budget(duration_s: float) -> tuple[float, float]:
        seconds = tuple(
            replace(row, noise_std_dev_kg_s=0.1, load_std_dev_kg=50.0, duration_s=duration_s, mass_kg=10.0 * duration_s)
            for row in SECONDS
        )
        found = reference(StoredLoad(LOAD, seconds, {1: known()}, False), MACHINE, SETTINGS).summary.budget
        return found.noise_kg2, found.parameters_kg

    (noise_kg2, parameters_kg), twice = budget(1.0), budget(2.0)
    assert twice == (pytest.approx(4.0 * noise_kg2), pytest.approx(2.0 * parameters_kg))
    assert noise_kg2 == pytest.approx(0.05)
