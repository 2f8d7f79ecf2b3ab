"""Slips of the hand in YAML files: each is named by its line, in plain words, with what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.errors import InputError
from yieldmon.files import machine_file, strict_yaml
from yieldmon.resources import shipped
from yieldmon.service.config import configuration

OF_YAML = [
    ("bus:\n\tchannel: can0\n", "f:2: has a tab; expected spaces"),
    ("a: {b: 0,3}\n", "f:1: a comma before 3 in a number within { }; expected a point in a decimal number"),
    ("a: {scale: 1,05, offset: 2}\n", "f:1: a comma before 05 in a number"),
    ('units: "us\nsweep: {}\n', "f:1: a quote that is not closed; expected the same quote"),
    ("sweep: {enabled: false\n# more\nbus: {}\n", "f:1: a { not closed"),
    ("angles: [40, 50\nbus: {}\n", "f:1: a [ not closed"),
    ('a: "C:\\Users\\me.yaml"\n', "f:1: a backslash in double quotes; expected single quotes"),
    ('a: "C:\\Qs\\me.yaml"\n', "f:1: a backslash in double quotes; expected single quotes"),
    ("bus:\n channel: can0\n  interface: x\n", "f:3: a second colon, or a line that is further in"),
    ("bus:\n  channel: can0\n interface: x\n", "f:3: is further in or out than the lines before it"),
    ("a: 1\nhello\nb: 2\n", "f:3: a key without a colon before this line"),
    ("group: @operators\n", "f:1: a text begins with @; expected quotes around it"),
]
OF_A_CONFIGURATION = [
    ("budget:\n  zero_mv: 0,3\n", "budget.zero_mv: '0,3'; expected a number from 0 to 100 mV (with a point, not a comma)"),
    ("sweep:\n  interval_s: 30 min\n", "from 60 to 1000000 s (the number alone, without a unit)"),
    ("plate: {fixed_angle_deg: 70°}\n", "or null (the number alone, without a unit)"),
    ("implement: {working_width_m: 9}\n", "implement: unknown key; expected it in the machine file, which machine_file names"),
    ("friction: 0.2\n", "friction: unknown key; expected it in the parameter file"),
    ("interval_s: 600\n", "interval_s: unknown key; expected sweep.interval_s: the line `sweep:` above it"),
    ("bus:\n  sweep: {enabled: false}\n", "bus.sweep: unknown key; expected sweep at the left margin"),
    ("sweep:\n  \u00a0enabled: false\n", "expected enabled, in plain letters"),
    ("units:metric\n", "'units:metric'; expected lines of key: value, with a space after the colon"),
    ("machine_file: gone.yaml\n", "c.yaml: machine_file: {folder}/gone.yaml: No such file"),
    ("parameter_file: wheat\n", "c.yaml: parameter_file: {folder}/wheat: No such file"),
    (
        "signals:\n  elevator_speed: {dbc: J1939.DBC, message: EEC1, signal: EngineSpeed}\n",
        "c.yaml: dbc: {folder}/J1939.DBC: No such file or directory; expected j1939.dbc, or a DBC file, named from {folder}",
    ),
    (
        "signals:\n  elevator_speed:\n    dbc: j1939.dbc\n    message: EEC1\n    signal: EngineSpeed\n    ratio: 0,2\n",
        "signals.elevator_speed.ratio: '0,2'; expected a number above 0 (with a point, not a comma)",
    ),
]
WIDTHS = [
    ("9,1", "'9,1'; expected a number from 0.1 to 30 m (with a point, not a comma)"),
    ("9.1 m", "'9.1 m'; expected a number from 0.1 to 30 m (the number alone, without a unit)"),
    ("30ft", "(the number alone, without a unit)"),
    ("wide", "'wide'; expected a number from 0.1 to 30 m"),
    ("91", "is 91; expected a number from 0.1 to 30 m"),
]


@pytest.mark.parametrize(("text", "message"), OF_YAML)
def test_a_slip_in_yaml_is_told_with_its_mend(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        strict_yaml.parse(text, "f")
    assert str(caught.value).startswith(message)
    assert "expected" in str(caught.value)


def test_numbered_codes_within_braces_are_no_decimal_commas() -> None:
    assert strict_yaml.parse("values: {1: 0, 0: 1}\n", "f") == {"values": {1: 0, 0: 1}}


@pytest.mark.parametrize(("text", "message"), OF_A_CONFIGURATION)
def test_a_slip_in_a_configuration_is_told_with_its_mend(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        configuration.load(path)
    assert message.format(folder=tmp_path) in str(caught.value)


@pytest.mark.parametrize(("width", "message"), WIDTHS)
def test_a_width_with_a_comma_or_a_unit_is_told_from_a_wrong_one(width: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(f"{shipped(machine_file.DEFAULT).read_text(encoding='utf-8')}implement: {{working_width_m: '{width}'}}\n")
    if width.isdigit():
        path.write_text(path.read_text().replace(f"'{width}'", width))
    with pytest.raises(InputError) as caught:
        machine_file.load(path)
    assert str(caught.value).endswith(message)


def test_a_key_of_the_machine_file_with_a_slip_names_the_right_one(tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(shipped(machine_file.DEFAULT).read_text(encoding="utf-8") + "implements: {}\n")
    with pytest.raises(InputError, match=r"implements: unknown key; expected implement$"):
        machine_file.load(path)
