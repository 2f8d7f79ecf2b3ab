"""Task data as terminals write them: sections that switch off, other devices in the same log."""

from __future__ import annotations

import csv
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions

from .test_rows_of_strangers import AREA_M2, MASS_KG, PASS_S, PASSES, SPEED_M_S, WIDTH_M, YIELD_T_HA, home, rows  # noqa: F401

COUNT = PASSES * PASS_S
FLOW_MG_S = MASS_KG / COUNT * 1e6
Value = tuple[int, str, Sequence[int]]


def device(number: int, elements: Sequence[tuple[str, str, int]]) -> str:
    """elements: identifier, type, and maximum width in mm, 0 for none."""
    parts = "".join(
        f'<DET A="{name}" B="{place}" C="{kind}" E="{place}" F="0">' + (f'<DOR A="{90 + place}"/>' if width else "") + "</DET>"
        for place, (name, kind, width) in enumerate(elements)
    )
    widths = "".join(f'<DPT A="{90 + n}" B="0046" C="{width}"/>' for n, (_, _, width) in enumerate(elements) if width)
    return f'<DVC A="DVC-{number}" B="machine {number}">{parts}{widths}</DVC>'


TASK = '<TSK A="TSK1" G="4"><TLG A="TLG00001"/></TSK>'


def document(*parts: str) -> str:
    return f'<ISO11783_TaskData VersionMajor="4">{"".join(parts)}</ISO11783_TaskData>'


def task_data(devices: Sequence[str], values: Sequence[Value], task: str = TASK) -> Path:
    """A log of rows() in which each record has all values."""
    folder = Path("TASKDATA")
    folder.mkdir()
    (folder / "TASKDATA.XML").write_text(document(*devices, task))
    log(folder, "TLG00001", values, range(COUNT))
    return folder


def log(folder: Path, name: str, values: Sequence[Value], which: range) -> None:
    listed = "".join(f'<DLV A="{ddi:04X}" B="" C="{element}"/>' for ddi, element, _ in values)
    (folder / f"{name}.xml").write_text(f'<TIM A="" D="4"><PTN A="" B="" D=""/>{listed}</TIM>')
    out = bytearray()
    for number, row in enumerate(rows(speeds=False)):
        if number not in which:
            continue
        since = row["time"] - 315_532_800.0
        out += struct.pack("<IH", round(since % 86400 * 1000), int(since // 86400))
        out += struct.pack("<iiB", round(row["latitude"] * 1e7), round(row["longitude"] * 1e7), 4)
        out += bytes([len(values)]) + b"".join(struct.pack("<Bi", k, one[2][number]) for k, one in enumerate(values))
    (folder / f"{name}.bin").write_bytes(out)


def mapped(folder: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    assert cli.main(["map", str(folder), "--out", "unused", "--products", "none", "--json", "--flow-delay", "0"]) == 0
    return json.loads(capsys.readouterr().out)


def test_sections_that_are_off_cut_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """In every second pass two of four sections work, beside ground that was cut, and bring half of the grain."""
    halved = np.arange(COUNT) // PASS_S % 2 == 1
    states = np.where(halved, 0b0101, 0b01010101)
    quarter = round(WIDTH_M / 4 * 1000)
    elements = [("DET-1", "1", 4 * quarter), *((f"DET-{n}", "4", quarter) for n in range(2, 6))]
    flow = np.where(halved, FLOW_MG_S / 2, FLOW_MG_S).round().astype(int).tolist()
    found = mapped(task_data([device(1, elements)], [(161, "DET-1", states.tolist()), (87, "DET-1", flow)]), capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(0.75 * MASS_KG, rel=0.01)
    assert found["area_ha"] * 1e4 == pytest.approx(0.75 * AREA_M2, rel=0.01)
    assert found["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


@pytest.mark.parametrize("where", ["log", "description"])
def test_the_width_is_that_of_the_device_that_measures_the_yield(where: str, capsys: pytest.CaptureFixture[str]) -> None:
    wide, narrow = round(1000 * WIDTH_M), 3000
    values: list[Value] = [(87, "DET-1", [round(FLOW_MG_S)] * COUNT)]
    if where == "log":
        values = [(67, "DET-9", [narrow] * COUNT), *values, (67, "DET-1", [wide] * COUNT)]
    described = where == "description"
    devices = [device(1, [("DET-1", "1", wide * described)]), device(2, [("DET-9", "1", narrow * described)])]
    found = mapped(task_data(devices, values), capsys)
    assert found["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert found["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


WHOLE: list[Value] = [(87, "DET-1", [round(FLOW_MG_S)] * COUNT), (67, "DET-1", [round(1000 * WIDTH_M)] * COUNT)]


def is_the_harvest(found: Any) -> None:
    assert found["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.01)
    assert found["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert found["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


@pytest.mark.parametrize("task", ["of two tasks", "of one task, twice"])
def test_a_log_that_is_named_twice_counts_once(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    tasks = TASK + TASK.replace("TSK1", "TSK2") if "two" in task else TASK.replace("<TLG", '<TLG A="TLG00001"/><TLG')
    found = mapped(task_data([device(1, [("DET-1", "1", 0)])], WHOLE, tasks), capsys)
    is_the_harvest(found)
    assert ("is named by two tasks" in str(found["sources"])) == ("two" in task)


@pytest.mark.parametrize("second", [range(300, COUNT), range(COUNT), range(COUNT // 2 - 5, COUNT)])
def test_rows_that_two_logs_hold_count_once(second: range, capsys: pytest.CaptureFixture[str]) -> None:
    folder = task_data([device(1, [("DET-1", "1", 0)])], WHOLE, TASK.replace("/></TSK>", '/><TLG A="TLG00002"/></TSK>'))
    log(folder, "TLG00001", WHOLE, range(COUNT // 2))
    log(folder, "TLG00002", WHOLE, second)
    found = mapped(folder, capsys)
    is_the_harvest(found)
    assert f"{COUNT // 2 - second.start} rows" in str(found["sources"][0]["skipped"])
    assert "TLG00001" not in str(found["delay"])


def test_a_flow_that_is_not_available_is_not_the_one_before(capsys: pytest.CaptureFixture[str]) -> None:
    """Every pass ends with 12 s of which the flow is not available, and the one before was twice the usual."""
    last = np.arange(COUNT) % PASS_S >= PASS_S - 12
    flow = np.full(COUNT, round(FLOW_MG_S))
    flow[np.flatnonzero(last) - 1] *= 2
    flow[last] = -(2**31)
    known = flow[~last].sum() / 1e6
    found = mapped(task_data([device(1, [("DET-1", "1", 0)])], [(87, "DET-1", flow.tolist()), WHOLE[1]]), capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(known, rel=0.001)


@pytest.mark.parametrize("sections", ["", "a width each", "one width for all"])
def test_a_width_that_never_changes_stands_in_the_description(sections: str, capsys: pytest.CaptureFixture[str]) -> None:
    wide = round(1000 * WIDTH_M)
    parts = [("DET-3", "4", wide // 2), ("DET-4", "4", wide // 2)] if sections else []
    machine = device(1, [("DET-1", "1", 0 if sections else wide), *parts]).replace('B="0046"', 'B="0043"')
    if "all" in sections:
        machine = machine.replace('<DOR A="92"/>', '<DOR A="91"/>').replace(f'<DPT A="92" B="0043" C="{wide // 2}"/>', "")
    is_the_harvest(mapped(task_data([machine], WHOLE[:1]), capsys))


def test_parts_of_a_task_file_in_files_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    folder = task_data([], WHOLE[:1], '<XFR A="DVC00001" B="1"/><XFR A="TSK00001" B="1"/><XFR A="PFD00001" B="1"/>')
    (folder / "DVC00001.XML").write_text(f"<XFC>{device(1, [('DET-1', '1', round(1000 * WIDTH_M))])}</XFC>")
    (folder / "TSK00001.XML").write_text(f"<XFC>{TASK.replace('TSK1', 'TSK7')}</XFC>")
    found = mapped(folder, capsys)
    is_the_harvest(found)
    assert "PFD00001.XML" in str(found["sources"][0]["skipped"])


SECTIONS = [(f"DET-{n}", "4", round(WIDTH_M * 250)) for n in range(2, 6)]
WIDE: Value = (67, "DET-1", [round(1000 * WIDTH_M)] * COUNT)
PER_AREA = [round(YIELD_T_HA * 1e5)] * COUNT
WET_PPM, DRIED_PPM = 200_000, 140_000
DRY_SHARE = (1e6 - WET_PPM) / (1e6 - DRIED_PPM)


def increase(every: int) -> list[int]:
    """A counter of kg that goes on from another field and is sent anew after so many records."""
    seconds = np.arange(COUNT) // every * every
    return np.floor(70_000 + (seconds + 1) * MASS_KG / COUNT).astype(int).tolist()


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([(182, "DET-1", [round(FLOW_MG_S * DRY_SHARE)] * COUNT), (184, "DET-1", [DRIED_PPM] * COUNT)], "dried to 14 %"),
        ([(181, "DET-1", [round(PER_AREA[0] * DRY_SHARE)] * COUNT), (184, "DET-1", [DRIED_PPM] * COUNT)], "dried to 14 %"),
        ([(90, "DET-1", increase(1))], "increase of the total"),
        ([(90, "DET-1", increase(7))], "increase of the total"),
        ([(87, "DET-1", [0] * COUNT), (84, "DET-1", PER_AREA)], "yield by area"),
        ([(84, section, PER_AREA) for section, _, _ in SECTIONS], "yield by area"),
    ],
    ids=["dry flow", "dry yield", "total", "total each 7 s", "a flow of 0", "yield of sections"],
)
def test_a_flow_follows_from_what_the_log_has(values: Sequence[Value], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    moisture: Value = (99, "DET-1", [WET_PPM] * COUNT)
    found = mapped(task_data([device(1, [("DET-1", "1", 0), *SECTIONS])], [*values, WIDE, moisture]), capsys)
    is_the_harvest(found)
    assert says in str(found["sources"][0]["notes"])


def test_sections_with_a_work_state_each(capsys: pytest.CaptureFixture[str]) -> None:
    """In every second pass two of four sections work, beside ground that was cut, and bring half of the grain."""
    halved = np.arange(COUNT) // PASS_S % 2 == 1
    states = [(141, name, np.where(halved & (k > 1), 0, 1).tolist()) for k, (name, _, _) in enumerate(SECTIONS)]
    flow = np.where(halved, FLOW_MG_S / 2, FLOW_MG_S).round().astype(int).tolist()
    found = mapped(task_data([device(1, [("DET-1", "1", 0), *SECTIONS])], [(87, "DET-1", flow), *states]), capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(0.75 * MASS_KG, rel=0.01)
    assert found["area_ha"] * 1e4 == pytest.approx(0.75 * AREA_M2, rel=0.01)
    assert found["sources"][0]["notes"] == []


@pytest.mark.parametrize("unknown", [(0, 0), (2**31 - 1, 2**31 - 1), (-1, -1), (900_000_000, 1_800_000_000)])
def test_places_that_say_not_known_are_no_ground(unknown: tuple[int, int], capsys: pytest.CaptureFixture[str]) -> None:
    """Of every 40 records five have no position."""
    folder = task_data([device(1, [("DET-1", "1", 0)])], WHOLE)
    records = bytearray((folder / "TLG00001.bin").read_bytes())
    length = len(records) // COUNT
    for number in range(COUNT):
        if number % 40 < 5:
            struct.pack_into("<ii", records, number * length + 6, *unknown)
    (folder / "TLG00001.bin").write_bytes(records)
    found = mapped(folder, capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.01)
    assert 0.8 * AREA_M2 < found["area_ha"] * 1e4 < AREA_M2


def test_logs_of_four_digits_are_not_said_to_be_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """Beside another table they were read, and called of no known kind."""
    folder = task_data([device(1, [("DET-1", "1", 0)])], WHOLE, TASK.replace("TLG00001", "TLG0001"))
    for ending in ("xml", "bin"):
        (folder / f"TLG00001.{ending}").rename(folder / f"TLG0001.{ending}")
    (folder / "TLG0001.CSV").write_text("Date,'99/-1\n2013-06-09,150000\n")
    found = mapped(folder, capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.01)
    assert [part["part"] for part in found["sources"][0]["skipped"]] == ["TLG0001.CSV"]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([(86, "DET-1", [9000] * COUNT), WIDE], "has yield as a volume (DDI 86), whose density it does not state"),
        ([WIDE], "has no yield); expected mass in the log (DDI 87, 84 or 90; dried 182, 181 or 183)"),
        ([(99, "DET-1", [150_000] * COUNT)], "has no yield); expected mass in the log (DDI 87, 84 or 90; dried 182, 181 or 183)"),
        ([(87, "DET-1", [round(FLOW_MG_S)] * COUNT)], "expected --width M"),
    ],
)
def test_a_log_that_lacks_something_says_what_would_do(
    values: Sequence[Value], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = task_data([device(1, [("DET-1", "1", 0)])], values)
    assert cli.main(["map", str(folder), "--out", "unused", "--products", "none"]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(("behind_s", "shift_s"), [(7200, 7200), (-5.5 * 3600, -5.5 * 3600), (20, 0), (1024 * 7 * 86400, 0)])
def test_a_local_clock_is_set_by_the_receivers(behind_s: float, shift_s: float, capsys: pytest.CaptureFixture[str]) -> None:
    """behind_s: of the receiver's clock; one of 1024 weeks is its mistake."""
    folder = task_data([device(1, [("DET-1", "1", 0)])], WHOLE)
    records, length = (folder / "TLG00001.bin").read_bytes(), (folder / "TLG00001.bin").stat().st_size // COUNT
    out = bytearray()
    for number in range(COUNT):
        record = records[number * length : (number + 1) * length]
        milliseconds, days = struct.unpack_from("<IH", record)
        receiver_s = days * 86400 + milliseconds / 1000 - behind_s
        out += record[:15] + struct.pack("<IH", round(receiver_s % 86400 * 1000), int(receiver_s // 86400)) + record[15:]
    (folder / "TLG00001.bin").write_bytes(out)
    header = folder / "TLG00001.xml"
    header.write_text(header.read_text().replace('D=""/>', 'D="" H="" I=""/>', 1))
    assert cli.main(["map", str(folder), "--out", "out", "--products", "csv", "--flow-delay", "0"]) == 0
    with Path("out/points.csv").open() as stream:
        first = next(csv.DictReader(stream))
    assert float(first["time_s"]) == pytest.approx(rows(speeds=False)[0]["time"] - shift_s, abs=0.01)


def offset(number: int, ddi: int, millimetres: int) -> str:
    return f'<DPT A="{number}" B="{ddi:04X}" C="{millimetres}"/>'


def element(name: str, kind: int, *references: int) -> str:
    return f'<DET A="{name}" B="1" C="{kind}" E="1" F="0">' + "".join(f'<DOR A="{one}"/>' for one in references) + "</DET>"


ANTENNA = element("DET-7", 7, 1, 2) + offset(1, 134, 870) + offset(2, 135, -300)
COMBINE = f'<DVC A="DVC-2" B="combine">{ANTENNA}{element("DET-6", 6, 3)}{offset(3, 134, 2322)}</DVC>'
HEADER = element("DET-1", 2) + element("DET-5", 6, 4) + offset(4, 134, -100)
OFFSET_SECTIONS = element("DET-2", 4, 10, 11) + element("DET-3", 4, 10, 12) + offset(10, 134, 4000) + offset(11, 135, -1500)
COUPLED = '<CNN A="DVC-1" B="DET-5" C="DVC-2" D="DET-6"/>'
SENT = [(134, "DET-1", [1372] * COUNT), (135, "DET-1", [250] * COUNT)]


@pytest.mark.parametrize(
    ("devices", "values", "task", "expected"),
    [
        # One device: 4.2 m ahead of the axle, the antenna 0.87 m.
        ([element("DET-1", 1, 5) + offset(5, 134, 4200) + ANTENNA], [], TASK, (3.33, 0.3)),
        # The header is a device of its own and sends its offsets; which connectors are coupled is said, or there is one each.
        ([HEADER, COMBINE], SENT, TASK, (2.322 - 0.87 + 0.1 + 1.372, 0.3 + 0.25)),
        (
            [HEADER, COMBINE.replace("</DVC>", element("DET-8", 6, 9) + offset(9, 134, -3000) + "</DVC>")],
            SENT, TASK.replace("<TLG", f"{COUPLED}<TLG"), (2.322 - 0.87 + 0.1 + 1.372, 0.3 + 0.25),
        ),
        # By the sections, from left to right.
        ([element("DET-1", 1) + OFFSET_SECTIONS + offset(12, 135, 2500) + ANTENNA], [], TASK, (3.13, 0.5 + 0.3)),
        # Not said: the antenna, the header, the coupling.
        ([element("DET-1", 1, 5) + offset(5, 134, 4200)], [], TASK, None),
        (
            [element("DET-1", 1) + ANTENNA], [], TASK,
            "the antenna's offsets (DDI 134, 135) are not applied, as the descriptions do not say where the header is",
        ),
        (
            [HEADER, COMBINE.replace("</DVC>", element("DET-8", 6, 9) + offset(9, 134, -3000) + "</DVC>")], SENT, TASK,
            "are not applied, as the descriptions do not say how the header is coupled",
        ),
        ([element("DET-1", 1, 5) + offset(5, 134, 42000) + ANTENNA], [], TASK, "41.13 m ahead of the antenna"),
    ],
)  # fmt: skip
def test_the_header_is_where_the_descriptions_say(
    devices: Sequence[str], values: Sequence[Value], task: str, expected: tuple[float, float] | str | None
) -> None:
    own = f'<DVC A="DVC-1" B="header">{devices[0]}</DVC>'
    table = sources.read(task_data([own, *devices[1:]], [*WHOLE, *values], task), ReadOptions())
    said = str(table.sources[0].notes)
    if isinstance(expected, tuple):
        assert table["header_ahead_m"] == pytest.approx(np.full(COUNT, expected[0]))
        assert table["header_right_m"] == pytest.approx(np.full(COUNT, expected[1]))
        assert f"{expected[0]:.2f} m ahead of the antenna and {expected[1]:.2f} m to the right" in said
        return
    assert np.isnan(table["header_ahead_m"]).all()
    assert (expected or "no offset") in f"{said} no offset"


def test_there_and_back_the_points_are_where_the_header_was(capsys: pytest.CaptureFixture[str]) -> None:
    """The header is 3.33 m ahead of the antenna and 0.3 m to its right, in passes to and fro."""
    own = f'<DVC A="DVC-1" B="combine">{element("DET-1", 1, 5) + offset(5, 134, 4200) + ANTENNA}</DVC>'
    folder = task_data([own], WHOLE)
    path, length = folder / "TLG00001.bin", (folder / "TLG00001.bin").stat().st_size // COUNT
    places = np.array([(row["latitude"], row["longitude"]) for row in rows(speeds=False)])
    m_deg = np.array([111_195.0, 111_195.0 * np.cos(np.radians(places[0, 0]))])
    steps = np.diff(places, axis=0, prepend=2 * places[:1] - places[1:2]) * m_deg
    begins = np.arange(COUNT) % PASS_S == 0
    steps[begins] = steps[np.flatnonzero(begins) + 1]
    ahead = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    # North and east; to the right of north is east.
    antenna = places - (3.33 * ahead + 0.3 * np.column_stack((-ahead[:, 1], ahead[:, 0]))) / m_deg
    out = bytearray(path.read_bytes())
    for number, place in enumerate(antenna):
        struct.pack_into("<ii", out, number * length + 6, *(round(value * 1e7) for value in place))
    path.write_bytes(out)
    assert cli.main(["map", str(folder), "--out", "out", "--products", "csv", "--flow-delay", "0"]) == 0
    assert "the header is 3.33 m ahead of the antenna and 0.30 m to the right" in capsys.readouterr().err
    with Path("out/points.csv").open() as stream:
        found = np.array([(float(row["latitude_deg"]), float(row["longitude_deg"])) for row in csv.DictReader(stream)])
    apart_m = np.linalg.norm((found - places) * m_deg, axis=1)
    turning = np.arange(COUNT) % PASS_S
    in_pass = (turning >= 3) & (turning < PASS_S - 3)
    assert apart_m[in_pass].max() < 0.05


@pytest.mark.parametrize("side", [1, -1], ids=["from the left", "from the right by their offsets"])
def test_sections_that_work_are_at_their_side(side: int) -> None:
    """Of four sections of 1, 1, 2 and 2 m the first two, the last one, all."""
    elements = [("DET-1", "1", 6000), *((f"DET-{n}", "4", width) for n, width in ((2, 1000), (3, 1000), (4, 2000), (5, 2000)))]
    states = np.array([0b0101, 0b01000000, 0b01010101])[np.arange(COUNT) % 3].tolist()
    middles = zip(range(2, 6), (2700, 1700, 200, -1800), strict=True)
    offsets = [(135, f"DET-{n}", [middle] * COUNT) for n, middle in middles] if side < 0 else []
    table = sources.read(task_data([device(1, elements)], [WHOLE[0], (161, "DET-1", states), *offsets]), ReadOptions())
    assert table["cut_right_m"][:3] == pytest.approx([-2.0 * side, 2.0 * side, 0.0])
    assert table["width_m"][:3] == pytest.approx([2.0, 2.0, 6.0])


@pytest.mark.parametrize(
    ("latency", "lag", "declared"), [(-14_999, 10_000, 14.999), (0, 10_000, 10.0), (500, 10_000, 10.0), (0, 0, None)]
)
def test_the_delay_is_the_age_of_the_values(latency: int, lag: int, declared: float) -> None:
    values = [*WHOLE, (143, "DET-1", [latency] * COUNT), (259, "DET-1", [lag] * COUNT)]
    table = sources.read(task_data([device(1, [("DET-1", "2", 0)])], values), ReadOptions())
    assert table.declared_flow_s == pytest.approx(declared)
