"""For how long each second of a weighed load stands, and which second stands for none."""

from __future__ import annotations

import json
import unicodedata
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from tests.service.test_remeasuring import MACHINE, known, rows
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.files.ticket_file import WeighedTicket, names_log
from yieldmon.frames import EstimateQuality
from yieldmon.physics.model import ForwardModel
from yieldmon.service.logs.force_seconds import force_seconds
from yieldmon.service.logs.measured_loads import MeasuredLoad, measured_loads
from yieldmon.service.logs.weighed_loads import loads_on, match, sweeps_of
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

OF_MOISTURE = ForwardModel(MACHINE, ("moisture_dependence",)).effect_parameters


@pytest.mark.parametrize(("effect_parameters", "stands"), [((), True), (OF_MOISTURE, False)])
def test_a_second_without_moisture_stands_for_no_time_only_where_the_model_needs_the_moisture(
    effect_parameters: tuple[str, ...], stands: bool
) -> None:
    plain = known()
    parameters = replace(plain, values=plain.values | dict.fromkeys(effect_parameters, 0.0))
    seconds = [replace(row, moisture_pct=pct) for row, pct in zip(rows(1, 0.0, seconds=3), (15.0, None, 20.0), strict=True)]
    duration_s = force_seconds(seconds, parameters, MACHINE).duration_s
    np.testing.assert_allclose(duration_s, [1.0, 1.0 if stands else np.nan, 1.0], rtol=1e-6)


UNKNOWN = [{"force_n": None}, {"force_n": 0.0}, {"plate_angle_deg": None}, {"elevator_speed_rpm": None}]


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_a_second_without_force_angle_or_speed_stands_for_no_time(unknown: dict[str, Any]) -> None:
    first, second = rows(1, 0.0, seconds=2)
    duration_s = force_seconds([replace(first, **unknown), second], known(), MACHINE).duration_s
    np.testing.assert_allclose(duration_s, [np.nan, 1.0], rtol=1e-6)


@pytest.mark.parametrize(("scatter_kg_s", "noise_sd"), [((0.3, 0.4), 0.025), ((0.3, None), 0.015), ((None, None), 0.0)])
def test_the_scatter_of_a_loads_seconds_is_its_own(scatter_kg_s: tuple[float | None, ...], noise_sd: float) -> None:
    """Two seconds of 10 kg each."""
    seconds = [replace(r, noise_std_dev_kg_s=kg_s) for r, kg_s in zip(rows(1, 0.0, seconds=2), scatter_kg_s, strict=True)]
    (load,) = match(measured_loads(seconds, {1: known()}), [WeighedTicket("1", "1", 20.0, 0.1, "line 2")], MACHINE)
    assert load.noise_sd == pytest.approx(noise_sd)


def stored(folder: Path, later_s: int = 0) -> Path:
    """Loads 1 and 2 of corn, 3 of wheat, 4 of corn and open; another load of wheat, 5, is the newest. later_s: of grain after the
    end of load 1."""
    crops = {1: "corn", 2: "corn", 3: "wheat", 4: "corn", 5: "wheat"}
    found = [row for n, crop in crops.items() for row in rows(n, 10.0 * n, version=1 + (crop == "wheat"), flow=6.0 + n)]
    found += [replace(row, time_s=row.time_s + 5.5) for row in rows(1, 10.0, seconds=later_s, flow=7.0)]
    found.sort(key=lambda row: row.time_s)
    wheat = replace(known(2, 900.0), provenance={"crop": "wheat"})
    with Store(folder / "s.sqlite") as store:
        batch = Batch(
            1,
            100.0,
            {},
            tuple(replace(row, number=i) for i, row in enumerate(found, 1)),
            tuple(Load(n, "", crop, 10.0 * n, None if n == 4 else 10.0 * n + 5.0, 50.0, None) for n, crop in crops.items()),
            parameter_versions=tuple(
                ParameterVersion(p.version, 0.0, "file", parameter_file.to_document(p)) for p in (known(), wheat)
            ),
        )
        store.commit([batch])
    return folder / "s.sqlite"


@pytest.mark.parametrize(
    ("tickets", "said"),
    [
        ("1,36\n3,50", "line 3, load: load 3 is of wheat, load 1 of corn; expected the tickets of one crop in a file"),
        ("2-3,90", "line 2, load: load 3 is of wheat, load 2 of corn; expected the tickets of one crop in a file"),
        (
            "1,36\n4,50",
            "line 3, load: load 4 is still open, so more grain may come; expected `yieldmon load stop` first, with the daemon "
            "running, or the tickets of the other loads",
        ),
    ],
)
def test_tickets_of_two_crops_or_of_the_open_load_are_refused(tmp_path, capsys, tickets: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(f"load,weighed_kg\n{tickets}\n")
    assert main(["calibrate", "--loads", str(stored(tmp_path)), "--tickets", str(tmp_path / "t.csv")]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("load", "density"), [(1, 800.0), (3, 900.0)])
def test_a_crops_tickets_move_that_crops_parameters(tmp_path, capsys, load: int, density: float) -> None:
    weighed_kg = 5.0 * (6.0 + load)
    (tmp_path / "t.csv").write_text(f"load,weighed_kg\n{load},{weighed_kg}\n")
    words = ["--tickets", str(tmp_path / "t.csv"), "--out", str(tmp_path / "new.yaml"), "--json"]
    assert main(["calibrate", "--loads", str(stored(tmp_path)), *words]) == 0
    [said] = json.loads(capsys.readouterr().out)["loads"]
    assert (said["before_kg"], said["after_kg"]) == pytest.approx((weighed_kg, weighed_kg), rel=1e-3)
    # Other curves that the force may follow move density and gain against each other; the crops' are 12 % apart.
    assert parameter_file.load(tmp_path / "new.yaml").values["density"] == pytest.approx(density, rel=0.02)


@pytest.mark.parametrize("times", [1.0, 1.3])
def test_loads_of_another_machine_than_the_shipped_one_need_its_configuration(times: float, tmp_path: Path, capsys) -> None:
    """times: what its geometry makes of the forces, over what that of the shipped machine makes of them."""
    found = [row for n in (1, 2) for row in rows(n, 100.0 * n, seconds=30, flow=6.0 + n)]
    with Store(tmp_path / "s.sqlite") as store:
        seconds = tuple(replace(row, number=i, mass_kg=times * row.mass_kg) for i, row in enumerate(found, 1))
        loads = tuple(Load(n, "", "corn", 100.0 * n, 100.0 * n + 31.0, 200.0, None) for n in (1, 2))
        version = ParameterVersion(1, 0.0, "file", parameter_file.to_document(known()))
        store.commit([Batch(1, 300.0, {}, seconds, loads, parameter_versions=(version,))])
    (tmp_path / "t.csv").write_text(f"load,weighed_kg\n1,{210 * times}\n2,{240 * times}\n")
    words = ["calibrate", "--loads", str(tmp_path / "s.sqlite"), "--tickets", str(tmp_path / "t.csv")]
    said = "its masses are 1.3 times what {} machine's geometry makes of the forces"
    assert main(words) == (0 if times == 1.0 else 2)
    err = capsys.readouterr().err
    assert (f"s.sqlite: {said.format('the shipped')}; expected --config FILE" in err) == (times != 1.0)
    assert main([*words, "--machine", "sprocket-8"]) == 0
    assert (f"{said.format('this')}: is it the configuration of the machine that" in capsys.readouterr().err) == (times != 1.0)


SILENT = {"mass_flow_kg_s": None, "quality": int(EstimateQuality.NOT_AVAILABLE), "mass_kg": 0.0, "coverage": 0.0}


@pytest.mark.parametrize(
    ("silent", "gone", "said"),
    [
        (0, 0, ""),
        (3, 0, "3 s of load 1, 7.5 % of its time, were not measured: what was weighed may be more than what was measured"),
        (0, 3, "3 s of load 1, 7.5 % of its time, were not measured"),
        (6, 0, "line 2, load: 6 s of load 1, 15 % of its time, were not measured; expected at most 10 %; a load measured whole"),
    ],
    ids=["whole", "a silent sensor", "seconds missing", "too many"],
)
def test_seconds_of_a_load_that_were_not_measured_are_said(tmp_path, capsys, silent: int, gone: int, said: str) -> None:
    found = rows(1, 100.0, seconds=40, flow=8.0)
    found = [replace(row, **SILENT) if 10 <= i < 10 + silent else row for i, row in enumerate(found)]
    del found[20 : 20 + gone]
    with Store(tmp_path / "s.sqlite") as store:
        load = Load(1, "", "corn", 100.0, 141.0, sum(row.mass_kg for row in found), None)
        version = ParameterVersion(1, 0.0, "file", parameter_file.to_document(known()))
        store.commit([Batch(1, 300.0, {}, tuple(found), (load,), parameter_versions=(version,))])
    (tmp_path / "t.csv").write_text("load,weighed_kg\n1,300\n")
    words = ["calibrate", "--loads", str(tmp_path / "s.sqlite"), "--tickets", str(tmp_path / "t.csv")]
    assert main(words) == (2 if silent == 6 else 0)
    err = capsys.readouterr().err
    assert said in err
    assert bool(said) == ("not measured" in err)


def test_grain_between_two_loads_is_of_neither(tmp_path, capsys) -> None:
    """`yieldmon load stop`: what comes from then on counts in the total alone."""
    (tmp_path / "t.csv").write_text("load,weighed_kg\n1,35\n")
    said = []
    for later_s in (0, 4):
        folder = tmp_path / str(later_s)
        folder.mkdir()
        words = ["--tickets", str(tmp_path / "t.csv"), "--out", str(folder / "new.yaml"), "--json"]
        assert main(["calibrate", "--loads", str(stored(folder, later_s)), *words]) == 0
        said.append(json.loads(capsys.readouterr().out)["loads"])
    assert said[1] == said[0]
    assert said[0][0]["before_kg"] == pytest.approx(35.0, rel=1e-3)


def test_a_store_measured_again_has_grain_between_two_loads_in_neither(tmp_path, capsys) -> None:
    words = ["--params", str(tmp_path / "known.yaml"), "--out", str(tmp_path / "out.csv"), "--json"]
    parameter_file.save(known(), tmp_path / "known.yaml")
    assert main(["process", str(stored(tmp_path, 4)), *words]) == 0
    document = json.loads(capsys.readouterr().out)
    first = document["loads"][0]
    assert (first["before_kg"], first["after_kg"]) == pytest.approx((35.0, 35.0), rel=1e-3)
    assert document["before_mass_kg"] == pytest.approx(35.0 + 4 * 7.0 + 5 * (8.0 + 9.0 + 10.0 + 11.0))


MEASURED = [
    MeasuredLoad(name, log, tuple(rows(1, 0.0)), {1: known()})
    for name, log in (("1", "day/a.log.gz"), ("2", "day/b.log"), ("3", "day/b.log"), ("4", ""))
]


@pytest.mark.parametrize(
    ("first", "last", "named"),
    [("1", "1", "1"), ("2", "4", "234"), ("a.log.gz", "a.log.gz", "1"), ("a", "a", "1"), ("else/a.log.gz", "else/a.log.gz", "1")],
)
def test_a_ticket_names_loads_by_number_or_by_their_log(first: str, last: str, named: str) -> None:
    found = loads_on(WeighedTicket(first, last, 50.0, 0.1, "line 2"), MEASURED)
    assert "".join(load.name for load in found) == named


@pytest.mark.parametrize("coding", ["NFC", "NFD"])
@pytest.mark.parametrize("name", ["2026.10.06 Fuhre ä", "2026.10.06 Fuhre ä.log", "2026.10.06 Fuhre ä.log.gz", "2026"])
def test_a_log_is_known_by_its_name_whatever_dots_and_accents_it_has(name: str, coding: Literal["NFC", "NFD"]) -> None:
    log = unicodedata.normalize(coding, "2026.10.06 Fuhre ä.log.gz")
    assert names_log(name, log)
    loads = [MEASURED[3], replace(MEASURED[0], log=f"day/{log}")]
    assert loads_on(WeighedTicket(name, name, 50.0, 0.1, "line 2"), loads) == loads[1:]


@pytest.mark.parametrize(
    ("first", "last", "said"),
    [
        ("b.log", "b.log", "line 2: b.log holds 2 loads; expected one of the numbers 2, 3"),
        ("3", "1", "line 2: is 3-1; expected the first load first"),
        ("5", "5", "line 2: is 5, no load that was measured; expected 1 to 4"),
        ("c.log", "c.log", "line 2: is c.log, no load that was measured; expected 1 to 4"),
    ],
)
def test_a_ticket_that_names_no_load_or_several_is_refused(first: str, last: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        loads_on(WeighedTicket(first, last, 50.0, 0.1, "line 2"), MEASURED)
    assert str(caught.value) == said


def swept(number: int, angles_deg: tuple[float, ...] = (40.0, 60.0, 80.0), **changes: Any) -> list[SecondRow]:
    plain = rows(1, 10.0 * number, seconds=len(angles_deg))
    given = {"usable_for_calibration": 1, "sweep_id": number, "force_n": 50.0, "force_std_dev_n": 0.5} | changes
    return [replace(row, plate_angle_deg=angle, **given) for row, angle in zip(plain, angles_deg, strict=True)]


def sweeps(*seconds: SecondRow, log: str = "a") -> list[list[float]]:
    """Angles of the sweeps that are found, deg."""
    found = sweeps_of([MeasuredLoad("1", log, seconds, {1: known()})])
    return [np.degrees(sweep.plate_angle_rad).round(6).tolist() for sweep in found]


def test_a_sweep_has_what_its_seconds_say() -> None:
    (sweep,) = sweeps_of([MeasuredLoad("1", "a", tuple(swept(3, elevator_speed_rpm=300.0)), {1: known()})])
    assert sweep.time_s.tolist() == [row.time_s for row in swept(3)]
    np.testing.assert_allclose(sweep.elevator_speed_rad_s, 300.0 * 2.0 * np.pi / 60.0)
    assert (sweep.force_n.tolist(), sweep.force_std_dev_n.tolist()) == ([50.0] * 3, [0.5] * 3)


NOT_WHOLE = [
    {"usable_for_calibration": 0}, {"sweep_id": 0}, {"force_n": None}, {"force_std_dev_n": None}, {"force_std_dev_n": 0.0},
    {"elevator_speed_rpm": None},
]  # fmt: skip


@pytest.mark.parametrize("change", NOT_WHOLE)
def test_seconds_that_lack_something_are_in_no_sweep(change: dict[str, Any]) -> None:
    assert sweeps(*swept(1, **change)) == []
    spoilt = replace(swept(2, (90.0,))[0], **change)
    assert sweeps(*swept(2), spoilt, *swept(1)) == [[40.0, 60.0, 80.0]] * 2


@pytest.mark.parametrize(
    ("angles_deg", "count"), [((40.0, 60.0), 0), ((40.0, 60.0, 60.4), 0), ((40.0, 60.0, 61.0), 1), ((40.0, 40.0, 60.0, 80.0), 1)]
)
def test_a_sweep_has_three_angles(angles_deg: tuple[float, ...], count: int) -> None:
    assert len(sweeps(*swept(1, angles_deg))) == count


def test_sweeps_numbered_anew_after_a_lost_state_are_others() -> None:
    before, after = swept(1, (40.0, 50.0, 60.0)), swept(1, (40.0, 60.0, 80.0))
    assert sweeps(*before, *swept(2), *after) == [[40.0, 50.0, 60.0], [40.0, 60.0, 80.0], [40.0, 60.0, 80.0]]


def test_the_newest_twenty_sweeps_count_and_logs_number_their_own() -> None:
    assert len(sweeps(*[row for k in range(1, 21) for row in swept(k)])) == 20
    many = sweeps(*[row for k in range(1, 24) for row in swept(k, (40.0, 50.0, 60.0 + k))])
    assert [angles[2] for angles in many] == [60.0 + k for k in range(4, 24)]
    both = [MeasuredLoad("1", log, tuple(swept(1)), {1: known()}) for log in ("a", "b")]
    assert len(sweeps_of(both)) == 2
    assert len(sweeps_of([both[0], both[0]])) == 1
