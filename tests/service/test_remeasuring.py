"""Loads measured again after a ticket: what the updates together say of the hours before, and what stays as it was."""

from __future__ import annotations

import json
import re
import sqlite3
import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tests.service.bench import START_S, ask, running, wait_for
from yieldmon.cli import main as cli
from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.engine.self_calibration.curve_states import aligned
from yieldmon.estimation.load_pattern import NAMES
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.self_calibration.steady_drift import advance, begin
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.history import remeasuring
from yieldmon.service.history.parameter_timeline import Timeline, timeline
from yieldmon.service.history.remeasuring_thread import RemeasuringJob, RemeasuringResult, RemeasuringThread
from yieldmon.service.history.update_steps import step_document, step_from_document
from yieldmon.service.logs.measured_loads import MeasuredLoad, measured_loads
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion, Step
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

MACHINE = Machine()
HOUR_S = 3600.0


def known(version: int = 1, density: float = 800.0) -> ParameterSet:
    values = {"friction": 0.3, "density": density, "shape_ratio": 2.0, "restitution": 0.5}
    return ParameterSet(values, ("density",), np.array([[30.0**2]]), version=version)


def update(hours: float, wandering: float, learnt: ParameterSet) -> Step:
    """A density that wandered by `wandering` (relative, per root hour) for some hours, then an update."""
    _, step = advance(begin(known(), {}), DriftRates({"density": wandering}, {}, {}), hours, 0.0)
    kept = CalibrationStep(1, 0.0, hours * HOUR_S, step, (learnt.values["density"],))
    return Step(2, hours * HOUR_S, step_document(kept))


def rows(load: int, begin_s: float, version: int = 1, seconds: int = 5, flow: float = 10.0) -> list[SecondRow]:
    force = float(np.real(ForwardModel(MACHINE, ()).force(
        Conditions(MACHINE.home_plate_angle_rad, 400.0 * RPM, mass_flow_kg_s=flow), known().values)))  # fmt: skip
    names = SecondRow.__dataclass_fields__
    plain = {name: 0 if field.type in (int, float) else "" if field.type is str else None for name, field in names.items()}
    return [
        SecondRow(
            **plain
            | {
                "number": i + 1,
                "time_s": begin_s + i,
                "duration_s": 1.0,
                "mass_kg": flow,
                "mass_flow_kg_s": flow,
                "load_number": load,
                "force_n": force,
                "plate_angle_deg": float(np.degrees(MACHINE.home_plate_angle_rad)),
                "elevator_speed_rpm": 400.0,
                "parameter_version": version,
                "coverage": 1.0,
            }
        )
        for i in range(seconds)
    ]


def factors_of(loads: Sequence[MeasuredLoad], line: Timeline) -> dict[int, float]:
    return {number: again.factor for number, again in remeasuring.remeasured(loads, line, MACHINE).items()}


def test_a_step_is_the_same_after_the_store() -> None:
    step = update(3.0, 0.02, known(2, 830.0))
    found = step_from_document(json.loads(json.dumps(step.document)))
    assert found is not None
    assert step_document(found) == step.document
    assert step_from_document({**step.document, "state": [1.0, 2.0]}) is None
    assert step_from_document({}) is None
    by_sweep = replace(found, widening=4.0, sweep_alone=True)
    assert step_document(step_from_document(json.loads(json.dumps(step_document(by_sweep))))) == step_document(by_sweep)


@pytest.mark.parametrize("widening", [0.5, float("inf"), float("nan"), None, "wide"])
def test_a_step_with_a_widening_that_makes_no_sense_is_none(widening: float | str | None) -> None:
    assert step_from_document({**update(3.0, 0.02, known(2, 830.0)).document, "widening": widening}) is None


def test_a_step_of_a_store_before_0_2_counts_whatever_its_source() -> None:
    document = dict(update(3.0, 0.02, known(2, 830.0)).document)
    del document["widening"], document["sweep_alone"]
    found = step_from_document(document)
    assert found is not None
    assert (found.widening, found.sweep_alone) == (1.0, False)


def test_an_update_by_a_sweep_is_not_posted() -> None:
    """A sweep moves the density by far, a ticket brings it to 840 kg/m3: loads are as the ticket alone has them."""
    _, before = advance(begin(known(), {}), DriftRates({"density": 0.01}, {}, {}), 2.0, 0.0)
    swept = replace(known(2, 950.0), covariance=np.array([[1.0]]))
    _, between = advance(begin(swept, {}), DriftRates({"density": 0.01}, {}, {}), 2.0, 0.0)
    learnt = replace(known(3, 840.0), covariance=np.array([[1e-3]]))
    lines = []
    for alone in (True, False):
        steps = [
            CalibrationStep(1, 0.0, 2.0 * HOUR_S, before, (950.0,), sweep_alone=alone),
            CalibrationStep(2, 2.0 * HOUR_S, 4.0 * HOUR_S, between, (840.0,)),
        ]
        reported = [Step(version, step.end_s, step_document(step)) for version, step in zip((2, 3), steps, strict=True)]
        lines.append(timeline(reported, learnt))
    for line in lines:
        assert line.versions == {1, 2, 3}
        assert line.at(4.0 * HOUR_S).values["density"] == pytest.approx(840.0, abs=0.01)
    # The walk is as it was recorded, relative to what the sweep had made of the density.
    expected = 30.0**2 / (30.0**2 + 2.0 * 8.0**2 + 2.0 * 9.5**2)
    assert lines[0].at(0.0).values["density"] == pytest.approx(800.0 + 40.0 * expected, abs=0.01)
    assert lines[0].at(0.0).values["density"] < 840.0 < lines[1].at(0.0).values["density"]


@pytest.mark.parametrize("wandering", [0.0, 0.02, 0.2])
def test_an_update_corrects_the_hours_before_it_by_as_much_as_they_have_in_common(wandering: float) -> None:
    early = 30.0**2 / (30.0**2 + (wandering * 800.0) ** 2 * 4.0)
    learnt = known(2, 840.0)
    line = timeline([update(4.0, wandering, learnt)], learnt)
    moved = [line.at(t).values["density"] - 800.0 for t in (0.0, 2.0 * HOUR_S, 4.0 * HOUR_S)]
    assert moved[2] == pytest.approx(40.0)
    assert moved[0] == pytest.approx(40.0 * early, rel=1e-6)
    assert moved[0] <= moved[1] <= moved[2]


@pytest.mark.parametrize(("density", "from_s"), [(860.0, -np.inf), (980.0, 30.0 * HOUR_S)])
def test_an_update_that_contradicts_the_drift_says_nothing_of_the_days_before(density: float, from_s: float) -> None:
    """The density is expected to 40 kg/m3 when the second update comes, 48 hours after the first."""
    _, step = advance(begin(known(2, 820.0), {}), DriftRates({"density": 0.005}, {}, {}), 48.0, 0.0)
    second = CalibrationStep(2, 30.0 * HOUR_S, 78.0 * HOUR_S, step, (density,))
    updates = [update(30.0, 0.005, known(2, 820.0)), Step(3, 78.0 * HOUR_S, step_document(second))]
    line = timeline(updates, known(3, density))
    assert line.holds_from_s == from_s
    assert remeasuring.earliest_s(line, 78.0 * HOUR_S) == max(from_s, 6.0 * HOUR_S)
    # The day itself is measured again whatever its update says.
    assert remeasuring.earliest_s(line, 40.0 * HOUR_S) == min(max(from_s, -32.0 * HOUR_S), 16.0 * HOUR_S)


def test_the_time_before_a_gain_that_is_no_restitution_any_more_is_measured_again_too() -> None:
    """Two tickets: the first moves the restitution, the second turns the gain into k2 and brings weights of the curve."""
    begun = replace(known(), covariance_names=("density", "restitution"), covariance=np.diag([30.0**2, 0.2**2]))
    _, first = advance(begin(begun, {}), DriftRates({"density": 0.005}, {}, {}), 2.0, 0.0)
    names, state = ("density", "k2", *NAMES), (900.0, 2.3, 0.2, 0.1, 0.0)
    values = {name: value for name, value in known().values.items() if name != "restitution"}
    learnt = ParameterSet(
        values | {"k1": 0.0} | dict(zip(names, state, strict=True)), names, np.diag([4.0, 1e-4, 1e-4, 1e-4, 1e-4]), version=3
    )
    middle = replace(begun, values=begun.values | {"density": 860.0, "restitution": 0.9}, version=2)
    drifting, second = advance(begin(middle, {}), DriftRates({"density": 0.005}, {}, {}), 2.0, 0.0)
    _, second = aligned(drifting, second, learnt)
    steps = [
        CalibrationStep(1, 0.0, 2.0 * HOUR_S, first, (860.0, 0.9), names=("density", "restitution")),
        CalibrationStep(2, 2.0 * HOUR_S, 4.0 * HOUR_S, second, state, names=names),
    ]
    stored = [Step(version, step.end_s, step_document(step)) for version, step in zip((2, 3), steps, strict=True)]
    line = timeline(stored, learnt)
    assert line.versions == {1, 2, 3}
    gains = [line.at(hours * HOUR_S).values["k2"] for hours in (0.0, 2.0, 4.0)]
    assert gains == pytest.approx([2.3, 2.3, 2.3], abs=0.05)
    sets = {1: begun, 2: middle, 3: learnt}
    found = factors_of(measured_loads([*rows(1, 100.0), *rows(2, 9000.0, version=2)], sets), line)
    assert sorted(found) == [1, 2]
    assert 0.4 < found[1] < found[2] < 1.0, "the more gain, the less grain makes the force"
    unnamed = [replace(step, document={**step.document, "names": []}) for step in stored]
    assert timeline(unnamed, learnt).versions == {2, 3}, "a store from before the names were kept"


def test_loads_of_other_parameters_stay_as_they_were_measured() -> None:
    learnt = known(2, 840.0)
    line = timeline([update(4.0, 0.0, learnt)], learnt)
    seconds = [*rows(1, 100.0), *rows(2, 9000.0), *rows(3, 9100.0, version=7)]
    found = factors_of(measured_loads(seconds, {1: known(), 2: learnt, 7: known(7)}), line)
    assert sorted(found) == [1, 2]
    assert found[1] == pytest.approx(found[2])
    assert 0.94 < found[1] < 1.06
    assert found[1] != 1.0


def test_parameters_that_a_change_of_crop_kept_as_another_version_count_as_one() -> None:
    """Version 1 measured; wheat's parameters of version 4 lie between; the ticket updated version 5, a copy of 1."""
    learnt, named = known(6, 840.0), {"crop": "corn"}
    sets = {
        1: known(), 3: replace(known(3), provenance=named), 4: known(4, 760.0), 5: replace(known(5), provenance=named), 6: learnt,
        7: replace(known(7), provenance={"crop": "barley"}),
    }  # fmt: skip
    step = update(4.0, 0.0, learnt)
    line = timeline([replace(step, version=6, document={**step.document, "from_version": 5})], learnt, sets)
    assert line.versions == {1, 3, 5, 6}
    assert line.at(0.0).values["density"] == pytest.approx(840.0)


def test_an_update_that_does_not_follow_on_the_one_before_speaks_for_its_own_time_only() -> None:
    learnt = known(5, 840.0)
    line = timeline([update(4.0, 0.0, known(2, 820.0))], learnt)
    assert line.versions == {5}
    assert line.at(0.0).values["density"] == 840.0


def test_updates_that_lead_to_themselves_come_to_an_end() -> None:
    """As a store that was tampered with may have them."""
    learnt = known(2, 840.0)
    step = update(4.0, 0.0, learnt)
    line = timeline([replace(step, document={**step.document, "from_version": 2})], learnt)
    assert line.versions == {2}


def test_loads_that_are_cut_or_open_are_left_alone() -> None:
    loads = (rows(1, 0.0), rows(2, 50.0), rows(3, 100.0))
    seconds = [replace(row, number=i) for i, row in enumerate((r for load in loads for r in load), 1)]
    assert {r.load_number for r in remeasuring.rows_of_whole_loads(seconds, 2.0, 3, 1)} == {2}
    later = [replace(r, number=r.number + 500) for r in seconds]
    assert {r.load_number for r in remeasuring.rows_of_whole_loads(later, -1.0, None, 501)} == {2, 3}
    assert {r.load_number for r in remeasuring.rows_of_whole_loads(later, -1.0, None, 1)} == {1, 2, 3}


DAY_S = 24.0 * HOUR_S


@pytest.mark.parametrize(
    ("lost", "open_load", "expected"),
    [(0, None, {2, 3, 4, 5}), (0, 5, {2, 3, 4}), (7, None, {3, 4, 5}), (12, None, {4, 5})],
)
def test_a_ticket_measures_the_loads_of_three_days_again(tmp_path, lost: int, open_load: int | None, expected: set[int]) -> None:
    """Loads of five days, of which the store has lost the first `lost` seconds; load 4 was measured with what was learnt."""
    learnt = known(2, 840.0)
    seconds = [r for load in range(1, 6) for r in rows(load, load * DAY_S, version=2 if load == 4 else 1)]
    numbered = [replace(row, number=i) for i, row in enumerate(seconds, 1)]
    sets = [ParameterVersion(p.version, 0.0, "file", parameter_file.to_document(p)) for p in (known(), learnt)]
    with Store(tmp_path / "s.sqlite") as store:
        batch = Batch(
            1, 5.0 * DAY_S, {}, tuple(numbered[lost:]), parameter_versions=tuple(sets), steps=(update(120.0, 0.01, learnt),)
        )
        store.commit([batch])
    found = remeasuring.of_store(tmp_path / "s.sqlite", MACHINE, 2, open_load, 5.0 * DAY_S + 60.0 - (DAY_S / 24.0))
    assert set(found) == expected
    changes = [abs(found[n].factor - 1.0) for n in sorted(found) if n != 4]
    assert changes == sorted(changes)
    assert changes[-1] > 0.01


def test_grain_after_a_loads_end_is_not_posted_with_it(tmp_path) -> None:
    """What came after the end was measured with what was learnt, and would halve the load's factor."""
    learnt, found = known(2, 840.0), []
    sets = [ParameterVersion(p.version, 0.0, "file", parameter_file.to_document(p)) for p in (known(), learnt)]
    for later_s in (0, 5):
        seconds = rows(1, DAY_S) + rows(1, DAY_S + 10.0, version=2, seconds=later_s)
        path = tmp_path / f"{later_s}.sqlite"
        with Store(path) as store:
            batch = Batch(
                1,
                DAY_S + 60.0,
                {},
                tuple(replace(row, number=i) for i, row in enumerate(seconds, 1)),
                loads=(Load(1, "", "", DAY_S, DAY_S + 5.0, 50.0, None),),
                parameter_versions=tuple(sets),
                steps=(update(120.0, 0.01, learnt),),
            )
            store.commit([batch])
        found.append(remeasuring.of_store(path, MACHINE, 2, None, DAY_S + 60.0))
    factors = [again[1].factor for again in found]
    assert factors[0] == pytest.approx(factors[1])
    assert abs(factors[0] - 1.0) > 0.005


def test_the_daemon_posts_after_a_ticket_lists_who_entered_it_and_takes_it_back(tmp_path, capsys) -> None:
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        for _ in range(2):
            ask(tmp_path, capsys, "load", "start")
            bench.play(6, 60.0)
            bench.played()
        ask(tmp_path, capsys, "load", "stop")
        before = {load["number"]: load for load in ask(tmp_path, capsys, "load", "list")["loads"]}
        weighed_kg = 1.1 * before[3]["mass_kg"]
        assert ask(tmp_path, capsys, "ticket", "3", f"{weighed_kg}kg", "--std-dev", f"{weighed_kg / 1000}kg")["ticket"] == 1

        def remeasured() -> bool:
            bench.play(1, 0.0)
            return ask(tmp_path, capsys, "load", "list")["loads"][1]["posted_mass_kg"] is not None

        wait_for(remeasured, "the loads to be measured again")
        after = {load["number"]: load for load in ask(tmp_path, capsys, "load", "list")["loads"]}
        assert [after[n]["mass_kg"] for n in (2, 3)] == [before[n]["mass_kg"] for n in (2, 3)]
        assert after[2]["posted_mass_kg"] == pytest.approx(1.1 * before[2]["mass_kg"], rel=0.02)
        assert after[2]["corrected_mass_kg"] == after[2]["posted_mass_kg"]
        assert after[3]["corrected_mass_kg"] == pytest.approx(weighed_kg)
        assert bench.status["loads"][-1]["posted_mass_kg"] == after[3]["posted_mass_kg"]
        (ticket,) = ask(tmp_path, capsys, "ticket", "list")["tickets"]
        assert (ticket["number"], ticket["undone_s"]) == (1, None)
        for system, unit, factor in (("us", "lb", 1.0 / 0.45359237), ("metric", "kg", 1.0)):
            listing = ["ticket", "list", "--units", system, "--socket", str(tmp_path / "yieldmon.sock")]
            assert cli.main(listing) == 0
            shown = re.findall(rf"([\d.,]+) {unit}\b", capsys.readouterr().out)
            assert [float(number.replace(",", "")) for number in shown] == [
                pytest.approx(factor * kg, rel=0.01) for kg in (before[3]["mass_kg"], weighed_kg)
            ]
        assert cli.main(["calibrations", "list", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
        assert "1970" not in capsys.readouterr().out
        assert ticket["who"]
        calibrations = ask(tmp_path, capsys, "calibrations", "list")["calibrations"]
        assert [(c["version"], c["origin"], c["state"]) for c in calibrations] == [(1, "file", ""), (2, "ticket", "in use")]
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert store.corrected_loads()[1]["corrected_mass_kg"] == after[2]["corrected_mass_kg"]
    with closing(sqlite3.connect(tmp_path / "yieldmon.sqlite")) as database:
        view = database.execute("SELECT number, corrected_mass_kg FROM load_corrected ORDER BY number").fetchall()
        assert view[1:] == [(n, pytest.approx(after[n]["corrected_mass_kg"])) for n in (2, 3)]
    with running(tmp_path, start_s=START_S + 600) as bench:
        undone = ask(tmp_path, capsys, "ticket", "undo", "1")
        assert (undone["undone"], undone["version"]) == (2, 3)
        loads = {load["number"]: load for load in ask(tmp_path, capsys, "load", "list")["loads"]}
        assert all(loads[n]["corrected_mass_kg"] == loads[n]["mass_kg"] == before[n]["mass_kg"] for n in (2, 3))
        assert ask(tmp_path, capsys, "ticket", "list")["tickets"][0]["undone_by"]
        states = {c["version"]: c["state"] for c in ask(tmp_path, capsys, "calibrations", "list")["calibrations"]}
        assert states == {1: "", 2: "undone", 3: "in use"}
        with pytest.raises(SystemExit):
            cli.main(["ticket", "undo", "1", "--socket", str(tmp_path / "yieldmon.sock")])
        assert "ticket 1: is undone already; expected a ticket that was entered" in capsys.readouterr().err
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert store.corrected_loads()[1]["corrected_mass_kg"] == before[2]["mass_kg"]
        versions = {v.version: parameter_file.from_document(v.document, "").values for v in store.parameter_versions()}
        assert versions[3] == versions[1] != versions[2]


@pytest.mark.parametrize("closed", [False, True], ids=["of the open load", "of a load that is closed"])
def test_a_zero_is_taken_back_across_a_restart(tmp_path, capsys, closed: bool) -> None:
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(6, 60.0)
        bench.played()
        expected_kg = bench.status["load"]["mass_kg"] + 40.0 * bench.rows[-1]["mass_kg"]
        assert ask(tmp_path, capsys, "zero", "--force")["zero"].startswith("started")
        bench.play(20, 60.0)
        bench.played()
        # Once more, under the wrong zero: the good one is still the one that comes back.
        assert ask(tmp_path, capsys, "zero", "--force")["zero"].startswith("started")
        bench.play(20, 60.0)
        bench.played()
        assert bench.status["load"]["mass_kg"] < 0.7 * expected_kg
        assert "ZeroDrifted" in bench.faults
        if closed:
            ask(tmp_path, capsys, "load", "stop")
    with running(tmp_path, start_s=START_S + 600) as bench:
        row, _ = [c for c in ask(tmp_path, capsys, "calibrations", "list")["calibrations"] if c["kind"] == "zero"]
        assert row["who"]
        assert "forced although" in row["what"]
        assert ask(tmp_path, capsys, "zero", "--undo")["restored_kg"] > 0.3 * expected_kg
        (load,) = ask(tmp_path, capsys, "load", "list")["loads"]
        # A second counted twice is 2 %.
        assert load["mass_kg"] == pytest.approx(expected_kg, rel=0.005)
        assert load["dry_mass_kg"] == pytest.approx(load["mass_kg"], rel=1e-6), "15.5 % of moisture, that of the market"
        states = [c["state"] for c in ask(tmp_path, capsys, "calibrations", "list")["calibrations"] if c["kind"] == "zero"]
        assert states == ["undone", "undone"]


def test_a_job_that_is_under_way_has_nothing_to_take_and_stays_under_way(tmp_path) -> None:
    go_on = threading.Event()
    with Store(tmp_path / "s.sqlite"):
        pass
    thread = RemeasuringThread(tmp_path / "s.sqlite", lambda timeout_s: go_on.wait(60.0))
    assert (thread.busy, thread.take()) == (False, None)
    thread.start(MACHINE, RemeasuringJob((4,), 2, None, 0.0))
    assert (thread.busy, thread.take(), thread.busy) == (True, None, True)
    go_on.set()
    found: list[RemeasuringResult | None] = []
    wait_for(lambda: found.append(thread.take()) or found[-1], "what came of the job")
    assert found[-1] is not None
    assert (found[-1].asked.tickets, found[-1].version) == ((4,), 2)
    assert (thread.busy, thread.take()) == (False, None)


def test_seconds_without_a_known_force_count_neither_in_mass_nor_in_time() -> None:
    """One second of twenty has none; with three of twenty the load is left as it was measured."""
    learnt = known(2, 840.0)
    line = timeline([update(4.0, 0.0, learnt)], learnt)
    for unknown, found in ((1, [1]), (2, []), (3, [])):
        plain = rows(1, 9000.0, version=2, seconds=20)
        seconds = [replace(row, force_n=None if i < unknown else row.force_n) for i, row in enumerate(plain)]
        factors = factors_of(measured_loads(seconds, {1: known(), 2: learnt}), line)
        assert list(factors) == found
        if found:
            assert factors[1] == pytest.approx(factors_of(measured_loads(plain, {1: known(), 2: learnt}), line)[1])
