"""Parameter files: exact round trip, and one line for each way to get them wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.files import parameter_file

finite = st.floats(min_value=-1e6, max_value=1e6, allow_nan=False)


def same(a: ParameterSet, b: ParameterSet) -> bool:
    return (
        dict(a.values) == dict(b.values)
        and a.covariance_names == b.covariance_names
        and np.array_equal(a.covariance, b.covariance)
        and a.response_unit == b.response_unit
        and a.version == b.version
        and dict(a.provenance) == dict(b.provenance)
    )


@settings(max_examples=60)
@given(
    friction=st.floats(min_value=0.0, max_value=5.0),
    density=st.floats(min_value=20.0, max_value=20000.0),
    impact=st.one_of(
        st.builds(lambda e: {"restitution": e}, st.floats(min_value=0.0, max_value=1.0)),
        st.builds(lambda a, b: {"k1": a, "k2": b}, finite, finite),
    ),
    offset=st.one_of(st.none(), st.floats(min_value=-1e-5, max_value=1e-5)),
    root=st.lists(finite, min_size=4, max_size=4),
    note=st.text(max_size=30),
)
def test_round_trip_is_exact(tmp_path_factory, friction, density, impact, offset, root, note):
    values = {"friction": friction, "density": density, "shape_ratio": 2.0, **impact}
    if offset is not None:
        values["zero_offset.force_n"] = offset
    half = np.array(root).reshape(2, 2)
    parameters = ParameterSet(values, ("friction", "density"), half @ half.T, version=3, provenance={"note": note.strip()})
    path = tmp_path_factory.mktemp("parameters") / "p.yaml"
    parameter_file.save(parameters, path)
    assert same(parameter_file.load(path), parameters)


@pytest.mark.parametrize("end", ["\x85", "\u2028", "\u2029", "\r", "\n", "\t"], ids=ascii)
def test_a_note_with_any_line_end_comes_back(end: str, tmp_path) -> None:
    note = f"0{end}0: ä {end}{end}#"
    values = {"friction": 0.2, "density": 1e3, "shape_ratio": 2.0, "restitution": 0.5}
    parameter_file.save(ParameterSet(values, provenance={"note": note}), tmp_path / "p.yaml")
    assert parameter_file.load(tmp_path / "p.yaml").provenance["note"] == note


def test_the_range_survives_in_the_units_people_use(tmp_path):
    calibrated = CalibratedRange((0.5, 25.0), tuple(np.radians([40.0, 90.0])), (31.0, 52.0), (12.0, 26.0))
    parameters = ParameterSet({"friction": 0.2, "density": 1e3, "shape_ratio": 2.0, "k1": 1.0, "k2": 0.5}, calibrated=calibrated)
    parameter_file.save(parameters, tmp_path / "p.yaml")
    text = yaml.safe_load((tmp_path / "p.yaml").read_text(encoding="utf-8"))
    assert text["calibrated_range"]["plate_angle_deg"] == [40.0, 90.0]
    back = parameter_file.load(tmp_path / "p.yaml").calibrated
    assert back.elevator_speed_rad_s == pytest.approx((31.0, 52.0), rel=1e-9)


def test_the_shipped_corn_loads():
    assert parameter_file.load().values["density"] > 0.0


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"model_error": 5}, "model_error: is 5.0; expected a number from 0 to 0.5 as a share of the force, 0.05 for 5 %"),
        ({"friction": -0.1}, "friction: is -0.1; expected a number from 0 to 5"),
        ({"friction": "low"}, "friction: is 'low'"),
        ({"restitution": 1.2}, "restitution: is 1.2"),
        ({"k1": 1.0, "k2": 1.0}, "either restitution, or k1 and k2"),
        ({"fricton": 0.1}, "fricton: unknown key"),
        ({"format": 9}, "format: is 9; expected 1"),
        ({"version": 0}, "version: is 0"),
        ({"effects": {"magic": {"a": 1}}}, "effect 'magic': unknown"),
        ({"effects": {"gravity": {"a": 1}}}, "effect parameter 'gravity.a': unknown"),
        ({"effects": {"zero_offset": {"force_n": "x"}}}, "effects.zero_offset.force_n: is 'x'; expected a finite number, N"),
        ({"covariance": {"names": ["friction"], "matrix": [[1.0, 2.0]]}}, "covariance.matrix: is not square"),
        ({"covariance": {"names": ["k1"], "matrix": [[1.0]]}}, "covariance names ['k1'] have no value"),
        ({"covariance": {"names": ["friction"], "matrix": [[-1.0]]}}, "negative variance"),
        ({"covariance": {"names": ["friction"] * 2, "matrix": [[1, 0], [0, 1]]}}, "covariance names ['friction'] more than once"),
        (
            {"covariance": {"names": ["friction", "density", "shape_ratio"], "matrix": [[1, 9, -0.9], [9, 99, 9], [-0.9, 9, 1]]}},
            "covariance.matrix: has correlations that cannot all be: their lowest eigenvalue is -0.81; expected 0 or more",
        ),
        ({"calibrated_range": {"plate_angle_deg": [90, 40]}}, "expected the lowest first"),
        ({"calibrated_range": {"colour": [1, 2]}}, "calibrated_range.colour: unknown key"),
    ],
)
def test_bad_values_are_named(tmp_path, change, expected):
    document = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6} | change
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        parameter_file.load(path)
    assert expected in str(caught.value)
    assert str(path) in str(caught.value)


_KNOWN = ParameterSet({"friction": 0.2, "density": 1e3, "shape_ratio": 2.0, "restitution": 0.5})


def _with(**values: float) -> ParameterSet:
    return replace(_KNOWN, values={**_KNOWN.values, **values})


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        (_with(density=1.1), "density: is 1.1; expected kg/m3; this looks like g/cm3 or t/m3"),
        (_with(friction=9.0), "friction: is 9.0; expected a number from 0 to 5"),
        (_with(**{"gravity.acceleration_m_s2": 98.1}), "gravity.acceleration_m_s2: is 98.1; expected a number from 0 to 12"),
        (replace(_KNOWN, model_error=5.0), "model_error: is 5.0; expected a number from 0 to 0.5 as a share of the force"),
        (replace(_KNOWN, model_error=float("nan")), "model_error: is nan; expected a number from 0 to 10"),
        (replace(_KNOWN, version=0), "version: is 0; expected a whole number from 1"),
        (replace(_KNOWN, calibrated=CalibratedRange((9.0, 1.0))), "mass_flow_kg_s: is [9.0, 1.0]; expected the lowest first"),
        (replace(_KNOWN, calibrated=CalibratedRange(plate_angle_rad=(40.0, 90.0))), "deg: is 2291"),
        (replace(_KNOWN, covariance_names=("density",), covariance=np.array([[1e32]])), "matrix: is 1e+32"),
        (replace(_KNOWN, provenance={"data": "x" * 100_000}), "characters; expected at most 100000"),
        (replace(_KNOWN, provenance={"machine": Path("a")}), "of type PosixPath; expected parameters of texts and"),
    ],
)  # fmt: skip
def test_what_would_not_be_read_back_is_not_written(tmp_path: Path, known: ParameterSet, expected: str) -> None:
    path = tmp_path / "p.yaml"
    with pytest.raises(InputError) as caught:
        parameter_file.save(known, path)
    assert expected in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert not path.exists()


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "p.yaml"
    parameters = ParameterSet({"friction": 0.2, "density": 1e3, "shape_ratio": 2.0, "restitution": 0.5})
    parameter_file.save(parameters, path)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        parameter_file.save(parameters, path)
    assert path.read_bytes() == before


def test_a_number_that_is_cut_off_is_refused_or_reported(tmp_path, caplog):
    """The rest of a number is a number as well, and a file that a full stick or a broken copy left ends anywhere."""
    path = tmp_path / "cut.yaml"
    parameter_file.save(parameter_file.load(), path)
    content = path.read_bytes()
    for size in range(1, content.index(b"effects:")):
        path.write_bytes(content[:size])
        caplog.clear()
        try:
            parameter_file.load(path)
        except InputError:
            continue
        assert content[size - 1 : size] == b"\n" or "its last line has no end" in caplog.text, size


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("restitution: 0.4\neffects: {gravity: {}}\n", "effects.gravity: has no parameter; expected acceleration_m_s2"),
        ("restitution: 0.4\neffects: {magic: {}}\n", "effects.magic: effect 'magic': unknown"),
        ("k1: 1\n", "need either restitution, or k1 and k2"),
        ("k2: 1\n", "need either restitution, or k1 and k2"),
    ],
)
def test_what_would_be_dropped_or_lacks_its_other_half_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("friction: 0.3\ndensity: 1100\nshape_ratio: 2\n" + text)
    with pytest.raises(InputError) as refused:
        parameter_file.load(path)
    assert message in str(refused.value)
    assert str(refused.value).startswith(f"{path}: ")


def test_sets_are_equal_by_what_they_hold(tmp_path: Path) -> None:
    known = parameter_file.load()
    parameter_file.save(known, tmp_path / "p.yaml")
    again = parameter_file.load(tmp_path / "p.yaml")
    assert again == known
    assert hash(again) == hash(known)
    assert replace(known, covariance=2.0 * known.covariance) != known
    assert replace(known, version=known.version + 1) != known
    assert known != dict(known.values)
