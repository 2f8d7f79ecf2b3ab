"""What the page says of days, loads, parameters, places and residuals, against what was put into the store."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.plant_sweeps import MACHINE, NONE
from tests.service.test_sweep_table import fill
from tests.web.standin import StandIn, row
from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.resources import shipped
from yieldmon.service.logs import sweep_table
from yieldmon.service.logs.recorded import last_parameters
from yieldmon.service.storage.batch import FaultEvent, Load, ParameterVersion, SweepRecord, Ticket
from yieldmon.web import history as history_module
from yieldmon.web.history import History

MIDNIGHT_S = 1_760_054_400.0
"""2025-10-10 00:00:00 UTC"""
DELAY_S = 12.0


@pytest.fixture(autouse=True)
def _zone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    os.environ.pop("TZ")
    time.tzset()


@pytest.fixture
def daemon(tmp_path: Path) -> StandIn:
    return StandIn(tmp_path, start_s=MIDNIGHT_S - 1000.0)


def unpacked(packed: bytes) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    count, last = struct.unpack_from("<II", packed)
    assert len(packed) == 8 + 12 * count
    degrees = np.frombuffer(packed, "<i4", 2 * count, 8) * 1e-7
    return last, degrees[:count], degrees[count:], np.frombuffer(packed, "<f4", count, 8 + 8 * count)


def test_days_are_summed_up_and_carried_on(daemon: StandIn) -> None:
    history = History(DELAY_S)
    for count in (600, 900, 300):
        daemon.seconds(count)
        history.document(daemon.store_path)
    days = {day["day"]: day for day in history.document(daemon.store_path)["days"]}
    assert list(days) == ["2025-10-10", "2025-10-09"]
    rows = [row(number, daemon.start_s) for number in range(1, 1801)]
    for name, part in (("2025-10-09", rows[:999]), ("2025-10-10", rows[999:])):
        mass_kg = sum(one.mass_kg for one in part)
        moisture = sum(one.mass_kg * one.moisture_pct for one in part) / mass_kg
        assert days[name]["mass_kg"] == pytest.approx(mass_kg)
        assert days[name]["harvesting_s"] == len(part) == days[name]["points"]
        assert days[name]["mean_flow_kg_s"] == pytest.approx(mass_kg / len(part))
        assert days[name]["moisture_pct"] == pytest.approx(moisture)
    for day in History(DELAY_S).document(daemon.store_path)["days"]:
        assert days[day["day"]] == pytest.approx(day)


def test_flow_is_moved_back_to_where_the_grain_was_cut(daemon: StandIn) -> None:
    daemon.seconds(500)
    last, longitude, latitude, flow = unpacked(History(DELAY_S).points(daemon.store_path))
    rows = [row(number, daemon.start_s) for number in range(1, 501)]
    assert last == 500
    assert len(flow) == 500 - int(DELAY_S)
    np.testing.assert_allclose(latitude, [one.latitude_deg for one in rows[:-12]], atol=1e-7)
    np.testing.assert_allclose(longitude, [one.longitude_deg for one in rows[:-12]], atol=1e-7)
    np.testing.assert_allclose(flow, [one.mass_flow_kg_s for one in rows[12:]], rtol=1e-6)


def test_places_of_a_day_or_a_load(daemon: StandIn) -> None:
    daemon.seconds(1500)
    history = History(0.0)
    counts = {
        day: len(unpacked(history.points(daemon.store_path, day=day))[3])
        for day in ("", "2025-10-09", "2025-10-10", "today", "2025-10-11", "'; DROP TABLE second; --")
    }
    assert list(counts.values()) == [1500, 999, 501, 501, 0, 0]
    assert [len(unpacked(history.points(daemon.store_path, load=load))[3]) for load in (1, 2)] == [1500, 0]


def test_today_is_the_day_of_the_newest_second_where_the_clock_was_ahead(daemon: StandIn) -> None:
    start_s = daemon.start_s
    daemon.start_s = start_s + 3650 * 86400.0
    daemon.seconds(20)
    daemon.start_s = start_s
    daemon.seconds(30)
    history = History(0.0)
    assert len(unpacked(history.points(daemon.store_path, day="today"))[3]) == 30


@pytest.mark.parametrize("most", [400, 1100, history_module.MOST_POINTS])
def test_places_that_are_kept_are_those_of_the_store(daemon: StandIn, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(history_module, "MOST_POINTS", most)
    kept = History(DELAY_S)
    kept.prepare(daemon.store_path)
    choices = ({}, {"day": "2025-10-09"}, {"day": "2025-10-10"}, {"day": "2025-10-11"}, {"load": 1}, {"load": 2})
    for count in (600, 1, 900, 300):
        daemon.seconds(count)
        for choice in choices:
            assert kept.points(daemon.store_path, **choice) == History(DELAY_S).points(daemon.store_path, **choice)
    # Older than what is kept.
    assert unpacked(kept.points(daemon.store_path, day="2025-10-09"))[0] == 999
    assert len(unpacked(kept.points(daemon.store_path))[3]) == min(most, 1801) - int(DELAY_S)


def test_an_empty_store_has_no_days(daemon: StandIn) -> None:
    history = History(DELAY_S)
    assert history.document(daemon.store_path)["days"] == []
    assert unpacked(history.points(daemon.store_path, day="today"))[0] == 0


def test_a_store_begun_anew_is_read_anew(daemon: StandIn) -> None:
    history = History(DELAY_S)
    daemon.seconds(100)
    history.document(daemon.store_path)
    for part in daemon.folder.glob("yieldmon.sqlite*"):
        part.unlink()
    daemon.number, daemon.start_s = 0, daemon.start_s + 86400
    daemon.seconds(10)
    days = history.document(daemon.store_path)["days"]
    assert [(day["day"], day["harvesting_s"]) for day in days] == [("2025-10-10", 10.0)]


def test_loads_tickets_sweeps_and_faults(daemon: StandIn) -> None:
    daemon.seconds(20)
    loads = (
        Load(1, "<i>north</i>", "corn", 1.0, 2.0, 1000.0, 900.0), Load(2, "south", "corn", 3.0, None, 50.0, None),
        Load(3, "", "", 4.0, 4.0, 0.0, 0.0), Load(4, "", "", None, None, 0.0, 0.0), Load(5, "", "", 5.0, None, 0.0, 0.0),
    )  # fmt: skip
    sweep = SweepRecord(5.0, "updated", "learnt", {"sweep_id": 1, "angles_deg": [60.0, 70.0], "parameter_version": 2})
    ticket, fault = Ticket(6.0, 1, 1, 1100.0, 1000.0, "scale"), FaultEvent(7.0, "FramesLost", True, "3 frames")
    daemon.commit(loads=loads, sweeps=(sweep,), tickets=(ticket,), faults=(fault,))
    found = History(DELAY_S).document(daemon.store_path)
    assert [(load["number"], load["field"], load["corrected_mass_kg"], load["std_dev_kg"]) for load in found["loads"]] == [
        (5, "", 0.0, None), (2, "south", 50.0, None), (1, "<i>north</i>", pytest.approx(1100.0), 40.0)
    ]  # fmt: skip
    assert found["empty_loads"] == [3, 4]
    assert [one["document"]["angles_deg"] for one in found["sweeps"]] == [[60.0, 70.0]]
    assert [(one["number"], one["note"], one["undone_s"]) for one in found["tickets"]] == [(1, "scale", None)]
    assert [one["state"] for one in found["tickets"]] == ["corrects its load"]
    assert [(one["code"], one["active"]) for one in found["faults"]] == [("FramesLost", True)]


def test_parameters_come_with_their_deviation(daemon: StandIn) -> None:
    known = parameter_file.load()
    daemon.commit(parameter_versions=(ParameterVersion(1, 5.0, "file", parameter_file.to_document(known)),))
    (version,) = History(DELAY_S).document(daemon.store_path)["parameters"]
    assert version["values"]["friction"]["value"] == pytest.approx(float(known.values["friction"]))
    assert version["values"]["friction"]["std_dev"] == pytest.approx(known.standard_deviation("friction"))


def test_residuals_are_what_the_sweeps_measured_over_the_model_at_each_angle_and_flow(tmp_path: Path) -> None:
    path = fill(tmp_path / "swept.sqlite", NONE, 6)
    found = History(DELAY_S).residuals(path, MACHINE)
    known = last_parameters(path)
    columns = sweep_table.read(path, MACHINE, known).table.columns
    assert (found["sweeps"], found["parameter_version"]) == (6, 2)
    assert sum(cell["visits"] for cell in found["cells"]) == len(columns["force_n"])
    model = ForwardModel(MACHINE, known.effects)
    for cell in found["cells"]:
        angle, flow = cell["plate_angle_deg"], cell["mass_flow_kg_s"]
        here = (columns["plate_angle_deg"] == angle) & (columns["mass_flow_kg_s"] == flow)
        at = Conditions(np.radians(angle), columns["elevator_speed_rpm"][here] * RPM, mass_flow_kg_s=flow)
        ratio = columns["force_n"][here] / np.real(model.force(at, known.values))
        assert cell["residual_pct"] == pytest.approx(100.0 * float(np.mean(ratio) - 1.0), abs=1e-9)
        if angle == 70.0:
            assert abs(cell["residual_pct"]) < 4.0 * cell["std_dev_pct"] + 0.5


@pytest.mark.parametrize("content", [b"", b"no store", b"SQLite format 3\0" + bytes(500)])
def test_a_file_that_is_no_store_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "s.sqlite"
    path.write_bytes(content)
    machine = machine_file.load(shipped(machine_file.DEFAULT))
    history = History(DELAY_S)
    for read in (history.document, history.points, lambda p: history.residuals(p, machine)):
        with pytest.raises(InputError) as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_a_missing_store_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        History(DELAY_S).document(tmp_path / "none.sqlite")


def test_reading_changes_no_byte_of_the_store(daemon: StandIn) -> None:
    daemon.seconds(50)
    before = {path.name: path.read_bytes() for path in daemon.folder.glob("yieldmon.sqlite*")}
    history = History(DELAY_S)
    history.document(daemon.store_path)
    history.points(daemon.store_path)
    assert {path.name: path.read_bytes() for path in daemon.folder.glob("yieldmon.sqlite*")} == before
