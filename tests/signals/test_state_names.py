"""Switches whose values a DBC names the other way round: a header counted as down where it was up."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from yieldmon.bus.databases import load_messages
from yieldmon.service.config import configuration
from yieldmon.service.config.mapping_notes import notes
from yieldmon.signals.state_names import codes_by_name

DBC = 'VERSION ""\nNS_ :\nBS_:\nBU_: Node\nBO_ 516 Switches: 1 Node\n SG_ {name} : 0|2@1+ (1,0) [0|3] "" Node\n{table}'


def dbc(folder: Path, name: str, table: str) -> Path:
    path = folder / "node.dbc"
    path.write_text(DBC.format(name=name, table=f"VAL_ 516 {name} {table} ;\n" if table else ""))
    return path


@pytest.mark.parametrize(
    ("quantity", "name", "table", "codes"),
    [
        ("header_down", "Header", '0 "down" 1 "up" 3 "SNA"', {0: 1, 1: 0}),
        ("header_down", "Header", '0 "up" 1 "down" 3 "SNA"', {}),
        ("header_down", "Header", '1 "HDR_RAISED" 2 "HDR_LOWERED"', {2: 1, 1: 0}),
        ("header_down", "Header", '0 "not down" 1 "down"', {}),
        ("header_down", "Header", '0 "false" 1 "true"', {}),
        ("header_down", "HeaderUp", "", {0: 1, 1: 0}),
        ("header_down", "HeaderUp", '0 "no" 1 "yes"', {0: 1, 1: 0}),
        ("header_down", "HeaderDown", "", {}),
        ("header_down", "HeaderSetup", "", {}),
        ("work_state", "Work", '0 "Active" 1 "Inactive"', {0: 1, 1: 0}),
        ("work_state", "Work", '0 "Disengaged" 1 "Engaged"', {}),
        ("unloading", "Auger", '1 "Off" 2 "On"', {2: 1, 1: 0}),
        ("actuator_state", "Plate", '0 "on" 1 "off"', {}),
    ],
)
def test_codes_by_the_names_of_values(quantity: str, name: str, table: str, codes: Mapping[int, int], tmp_path: Path) -> None:
    bits = load_messages(dbc(tmp_path, name, table))["Switches"].signals[name]
    assert codes_by_name(quantity, bits) == codes


@pytest.mark.parametrize(("values", "said"), [("", True), (", values: {0: 1, 1: 0}", False), (", values: {1: 1, 0: 0}", False)])
def test_a_mapping_against_the_names_is_noted(values: str, said: bool, tmp_path: Path) -> None:
    dbc(tmp_path, "Header", '0 "down" 1 "up"')
    (tmp_path / "c.yaml").write_text(f"signals:\n  header_down: {{dbc: node.dbc, message: Switches, signal: Header{values}}}\n")
    found = [note for note in notes(configuration.load(tmp_path / "c.yaml")) if "header_down" in note]
    assert (
        found
        == ["header_down is taken as Header has it, 1 at cutting height; the DBC's names say otherwise: values: {0: 1, 1: 0}"]
        * said
    )


@pytest.mark.parametrize(
    ("again", "said"),
    [
        ('0 "Up" 1 "Down"', False),
        ('1 "Down"\n 0  "Up"', False),
        ('0 "Down" 1 "Up"', True),
        ('0 "Up"', True),
        ('0 "Up" 1 "Down" --1 "Lost" 1e "Lost"', True),
    ],
)
def test_two_tables_of_names_that_differ_are_noted(again: str, said: bool, tmp_path: Path) -> None:
    """As where two versions of a DBC were joined: the last table counted, silently."""
    path = dbc(tmp_path, "Header", f'0 "Up" 1 "Down" ;\nVAL_ 516 Header {again}')
    assert load_messages(path)["Switches"].signals["Header"].names_differ is said
    (tmp_path / "c.yaml").write_text("signals:\n  header_down: {dbc: node.dbc, message: Switches, signal: Header}\n")
    found = [
        note for note in notes(configuration.load(tmp_path / "c.yaml")) if "several tables of value names for Header" in note
    ]
    assert len(found) == said
