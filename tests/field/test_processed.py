"""Seconds that `process` wrote are a harvest as a store's are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.test_store import batch, second
from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.service.logs.tables import open_table
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

WIDTH = ReadOptions(width_m=9.0)


def harvest() -> list[SecondRow]:
    """A minute to the north at 2 m/s."""
    way = {"longitude_deg": 9.0, "ground_speed_m_s": 2.0, "course_deg": 0.0, "moisture_pct": 15.0}
    return [replace(second(k, load_number=1 + k // 40), latitude_deg=48.0 + 1.8e-5 * k, **way) for k in range(1, 61)]


@pytest.mark.parametrize("suffix", [".parquet", ".jsonl"])
def test_a_table_of_seconds_is_read_as_the_store_with_the_same_seconds(tmp_path: Path, suffix: str) -> None:
    rows = harvest()
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([batch(1, seconds=tuple(rows))])
    with open_table(str(tmp_path / f"rows{suffix}")) as writer:
        for row in rows:
            writer.write(row)
    table, of_store = sources.read(tmp_path / f"rows{suffix}", WIDTH), sources.read(tmp_path / "s.sqlite", WIDTH)
    assert table.columns.keys() == of_store.columns.keys()
    for name, values in of_store.columns.items():
        np.testing.assert_array_equal(table[name], values, err_msg=name)
    assert table.sources[0].mass_kg == of_store.sources[0].mass_kg == pytest.approx(600.0)
    np.testing.assert_array_equal(table.labels["load"].codes, of_store.labels["load"].codes)


@pytest.mark.parametrize(
    ("second_field", "mass_of_field_kg"),
    [("north", {"north": 600.0}), ("south", {"north": 250.0, "": 150.0, "south": 200.0})],
    ids=["one field", "two fields"],
)
def test_grain_between_a_loads_end_and_the_next_ones_begin_is_no_part_of_it(
    tmp_path: Path, second_field: str, mass_of_field_kg: dict[str, float]
) -> None:
    """Its seconds carry the ended load's number; in the daemon's lists they count in the total alone."""
    rows = [
        replace(row, load_number=1, load_kg=min(row.load_kg, 250.0))
        if row.number <= 40
        else replace(row, load_number=2, load_kg=row.load_kg - 400.0)
        for row in harvest()
    ]
    with Store(tmp_path / "s.sqlite") as store:
        loads = (
            Load(1, "north", "corn", 1.7e9, 1.7e9 + 25.0, 250.0, None),
            Load(2, second_field, "corn", 1.7e9 + 40.0, None, 200.0, None),
        )
        store.commit([batch(1, seconds=tuple(rows), loads=loads)])
    table = sources.read(tmp_path / "s.sqlite", WIDTH)

    def mass_kg(by: str) -> dict[str, float]:
        label = table.labels[by]
        return {name: float(table["flow_kg_s"][label.codes == code].sum()) for code, name in enumerate(label.names)}

    assert mass_kg("load") == pytest.approx({"1": 250.0, "": 150.0, "2": 200.0})
    assert mass_kg("field") == pytest.approx(mass_of_field_kg)
    assert mass_kg("crop") == pytest.approx({"corn": 600.0})


def test_the_width_is_that_of_the_daemons_areas(tmp_path: Path) -> None:
    """Of the header that it had then; a second without an area has that of the nearest one with."""
    way = {"longitude_deg": 9.0, "ground_speed_m_s": 2.0, "course_deg": 0.0}
    rows = [
        second(k, latitude_deg=48.0 + 1.8e-5 * k, area_m2=2.0 * (9.1 if k <= 200 else 6.1) if k % 30 > 5 else 0.0, **way)
        for k in range(1, 401)
    ]
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([batch(1, seconds=tuple(rows))])
    table = sources.read(tmp_path / "s.sqlite", ReadOptions())
    assert table["width_m"] == pytest.approx(np.repeat([9.1, 6.1], 200))
    assert "width 6.1 to 9.1 m, by the areas that it holds (else --width)" in table.sources[0].notes
    assert sources.read(tmp_path / "s.sqlite", WIDTH)["width_m"] == pytest.approx(np.full(400, 9.0))
    with Store(tmp_path / "none.sqlite") as store:
        store.commit([batch(1, seconds=tuple(harvest()))])
    with pytest.raises(InputError, match="has no working width; expected --width M"):
        sources.read(tmp_path / "none.sqlite", ReadOptions())


@pytest.mark.parametrize("options", [WIDTH, ReadOptions()], ids=["a width", "no width"])
@pytest.mark.parametrize(
    ("lacking", "what"),
    [
        ({"longitude_deg": None}, "position"),
        ({"longitude_deg": None, "latitude_deg": None}, "position"),
        ({"ground_speed_m_s": None}, "ground speed"),
    ],
)
def test_a_store_without_places_or_speeds_says_what_to_put_on_the_bus(
    lacking: dict[str, None], what: str, options: ReadOptions, tmp_path: Path
) -> None:
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([batch(1, seconds=tuple(replace(row, **lacking) for row in harvest()))])
    with pytest.raises(InputError, match=f"no second has a {what}; expected position .* on the bus while harvesting: `signals`"):
        sources.read(tmp_path / "s.sqlite", options)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.jsonl", b"", "has no seconds"),
        ("a.jsonl", b'{"number": 1}\n', "has no column 'time_s'"),
        ("a.parquet", b"PAR1 and no more", "Parquet"),
    ],
)
def test_what_is_no_such_table_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=says) as refused:
        sources.read(tmp_path / name, WIDTH)
    assert "\n" not in str(refused.value)
