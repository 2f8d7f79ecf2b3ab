"""Names from outside on their way to terminals, spreadsheets and XML."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.files.plain_text import cell, plain


@given(st.text())
def test_any_name_makes_well_formed_xml_and_one_line(text):
    element = ET.Element("PFD", C=plain(text))
    assert ET.fromstring(ET.tostring(element, encoding="unicode").encode()).attrib["C"] == plain(text)
    assert len(plain(text).splitlines()) <= 1
    assert len(plain(text)) == len(text)


@pytest.mark.parametrize("formula", ["=cmd|' /C calc'!A0", "+1", "-1+2", "@SUM(A1)", "\t=1", "\r=1"])
def test_a_formula_is_shown_and_not_run(formula):
    assert cell(formula)[0] not in "=+-@\t\r"


@pytest.mark.parametrize("name", ["north field", "Löß 3", "畑", "a-b", "x=y"])
def test_an_ordinary_name_stays_as_it_is(name):
    assert plain(name) == cell(name) == name


@pytest.mark.parametrize("text", ["\x1b]0;title\x07", "a\x9b31m", "\u202eevil", "a\nb", "\x00", "\ud800", "\ufffe"])
def test_what_a_terminal_obeys_or_xml_refuses_is_replaced(text):
    assert "\ufffd" in plain(text)
