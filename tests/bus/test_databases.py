"""DBC files as editors and converters of others write them: what matters of them is read, or refused in a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.bus.databases import MessageBits, load_messages
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.service.config import configuration

PLAIN = """VERSION ""

NS_ :
    CM_
    VAL_

BS_:

BU_: A

BO_ 2566844926 Shaft: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Speed m2 : 8|16@1+ (0.5,0) [0|100] "rpm" A
 SG_ Load : 32|32@1- (1,0) [0|0] "kg" A

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566844926 3;
VAL_ 2566844926 Page 2 "Speed" ;
SIG_VALTYPE_ 2566844926 Load : 1;
"""


def messages(folder: Path, text: str) -> object:
    (folder / "m.dbc").write_text(text, encoding="utf-8")
    return load_messages(folder / "m.dbc")


@pytest.mark.parametrize(
    ("sound", "odd"),
    [
        ("BS_:", 'CM_ "no end"\n\nBS_:'),
        ("VAL_ 25", 'CM_ BO_ 2566844926 "he said ""turn"" \n and BO_ 1 X: 8 A";\nVAL_ 25'),
        ("VAL_ 25", 'CM_ 145 "of nothing";\nVAL_ 25'),
        ("BA_ ", 'BA_DEF_ BO_ "Receivable" BOOL False True;\nBA_ '),
        ("BA_ ", 'BA_ "GenMsgCycleTime" BO_ 2566844926 100;\nBA_ '),
        ("SIG_VALTYPE_ ", "SIG_VALTYPE_ 999 Gone : 1;\nSIG_VALTYPE_ "),
        ("Load : 1", "Load 1"),
        ("(0.5,0)", "(.5,+0)"),
        ("[0|100]", "[|]"),
        ("[0|100]", "[-INF|NaN]"),
        ("[0|100]", "[0|-1.#IND]"),
        ('"rpm" A', '"rpm"'),
        ("Shaft: 8 A", "Shaft: 8"),
        ("\n", "\r\n"),
        ("\n", "\r"),
    ],
)
def test_what_matters_is_read_of_an_odd_file(tmp_path: Path, sound: str, odd: str) -> None:
    """Found in public databases, or written by canmatrix of a PEAK symbol file."""
    expected = messages(tmp_path, PLAIN)["Shaft"]  # type: ignore[index]
    found = messages(tmp_path, PLAIN.replace(sound, odd))["Shaft"]  # type: ignore[index]
    assert found.j1939
    assert [(one.name, one.mux, one.kind, one.scale, one.unit, one.choices) for one in found.signals.values()] == [
        ("Page", (), "uint", 1.0, "", {"Speed": 2}),
        ("Speed", (2,), "uint", 0.5, "rpm", {}),
        ("Load", (), "float", 1.0, "kg", {}),
    ]
    assert [one.places for one in found.signals.values()] == [one.places for one in expected.signals.values()]


@pytest.mark.parametrize("bit_rate", ["", " 500000:1,2"])
def test_names_of_more_than_32_characters_are_those_of_their_attributes(tmp_path: Path, bit_rate: str) -> None:
    """Also where cantools refuses something else; messages then had their short names."""
    long = """BA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;
BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;
BA_DEF_DEF_ "SystemMessageLongSymbol" "";
BA_DEF_DEF_ "SystemSignalLongSymbol" "";
BA_ "SystemMessageLongSymbol" BO_ 2566844926 "Shaft_of_the_clean_grain_elevator_at_the_top";
BA_ "SystemSignalLongSymbol" SG_ 2566844926 Speed "Speed_of_the_clean_grain_elevator_at_the_top";
"""
    found = messages(tmp_path, PLAIN.replace("BS_:", f"BS_:{bit_rate}").replace("VAL_ 25", f"{long}VAL_ 25"))
    (message,) = found.values()  # type: ignore[attr-defined]
    assert message.name == "Shaft_of_the_clean_grain_elevator_at_the_top"
    assert list(message.signals) == ["Page", "Speed_of_the_clean_grain_elevator_at_the_top", "Load"]
    assert message.signals["Speed_of_the_clean_grain_elevator_at_the_top"].mux == (2,)


@pytest.mark.parametrize(
    ("sound", "odd", "said"),
    [
        ("Speed m2", "Dreh-zahl m2", "line 13: `SG_ Dreh` cannot be followed by `-zahl"),
        ("(0.5,0)", "(0,5,0)", "line 13"),
        ('"kg" A', '"kg A', "cannot be followed by"),
        ("VAL_ 25", 'CM_ "a plate of 5" steel";\nVAL_ 25', "line 20"),
    ],
)
def test_a_message_or_signal_that_cannot_be_read_is_told_with_its_line(tmp_path: Path, sound: str, odd: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        messages(tmp_path, PLAIN.replace(sound, odd))


def test_messages_of_one_name_are_told_apart_by_their_identifiers(tmp_path: Path) -> None:
    """As in a logger maker's DBC of its receivers; two of one identifier that differ cannot be bound."""
    other = 'BO_ 7 Other: 8 A\n SG_ X : 0|8@1+ (1,0) [0|0] "" A\n\n'
    twice = other.replace("7 Other", "9 Twice")
    more = other + other.replace("7 Other", "8 Shaft") + twice + twice.replace("(1,0)", "(2,0)")
    found = messages(tmp_path, PLAIN.replace("BA_DEF_ BO_", more + "BA_DEF_ BO_"))
    bits: dict[str, MessageBits] = found  # type: ignore[assignment]
    assert {name: (message.name, len(message.signals)) for name, message in bits.items()} == {
        "Shaft 0x18FEF1FE": ("Shaft 0x18FEF1FE", 3), "Other": ("Other", 1), "Shaft 0x8": ("Shaft 0x8", 1),
        "Twice 0x9": ("Twice 0x9", 0),
    }  # fmt: skip
    assert bits["Twice 0x9"].contradiction == "Twice 0x9 is there twice, and the two differ"
    path = tmp_path / "c.yaml"
    path.write_text("signals:\n  moisture: {dbc: m.dbc, message: Shaft 0x8, signal: X, unit: '%'}\n")
    assert [group.message.frame_id for group in configuration.load(path).signals.groups] == [8]
    path.write_text("signals:\n  moisture: {dbc: m.dbc, message: Shaft, signal: X, unit: '%'}\n")
    with pytest.raises(InputError, match=r"Shaft is not in m\.dbc; expected .* such as Shaft 0x18FEF1FE, Shaft 0x8"):
        configuration.load(path)


def test_a_message_that_is_there_again_with_the_same_signals_counts_once(tmp_path: Path) -> None:
    """As where two files that share a part were joined into one."""
    found: dict[str, MessageBits] = messages(tmp_path, PLAIN + PLAIN)  # type: ignore[assignment]
    assert found == messages(tmp_path, PLAIN)
    (tmp_path / "m.dbc").write_text(PLAIN + PLAIN)
    path = tmp_path / "c.yaml"
    path.write_text("signals:\n  tank_mass: {dbc: m.dbc, message: Shaft, signal: Load}\n")
    assert [group.message.frame_id for group in configuration.load(path).signals.groups] == [0x18FEF1FE]


OTHER = 'BO_ 7 Other: 8 A\n SG_ X : 0|8@1+ (1,0) [0|0] "%" A\n\n'
ODD = 'BO_ 9 Odd: 8 A\n SG_ Y : 0|8@1+ (1,0) [0|0] "" A\n SG_ Z : 8|8@1+ (1,0) [0|0] "" A\n\n'


@pytest.mark.parametrize(
    ("odd", "name", "said"),
    [
        (ODD.replace("SG_ Z", "SG_ 2Z"), "Odd", "`SG_ 2Z : 8|8@1"),
        (ODD.replace("SG_ Y", "SG_ Y-1"), "Odd", "`SG_ Y-1 : 0|8@1"),
        (ODD.replace("8@1+ (1,0)", "8@1+ (0,5,0)"), "Odd", "(0,5,0)"),
        (ODD.replace("9 Odd", "9 4Odd"), "4Odd", "`BO_ 9 4Odd: 8 A` is not a line of a DBC file"),
        (ODD.replace("BO_ 9", "BO_ 5000000000"), "Odd", "the identifier 5000000000 has more than 29 bits"),
    ],
)
def test_a_message_that_no_dbc_may_have_leaves_the_others(
    tmp_path: Path, odd: str, name: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """One such name refused a maker's whole file."""
    text = PLAIN.replace("BA_DEF_ BO_", OTHER + odd + "BA_DEF_ BO_").replace("VAL_ 25", 'VAL_ 9 2Z 0 "off" ;\nVAL_ 25')
    found: dict[str, MessageBits] = messages(tmp_path, text)  # type: ignore[assignment]
    plain: dict[str, MessageBits] = messages(tmp_path, PLAIN)  # type: ignore[assignment]
    assert found["Shaft"] == plain["Shaft"]
    assert list(found["Other"].signals) == ["X"]
    assert not found[name].signals
    assert said in found[name].contradiction
    path = tmp_path / "c.yaml"
    (tmp_path / "m.dbc").write_text(text)
    path.write_text("signals:\n  moisture: {dbc: m.dbc, message: Other, signal: X}\n")
    assert [group.message.name for group in configuration.load(path).signals.groups] == ["Other"]
    path.write_text(f"signals:\n  moisture: {{dbc: m.dbc, message: {name}, signal: Y}}\n")
    with pytest.raises(InputError) as refused:
        configuration.load(path)
    assert said in str(refused.value)
    (tmp_path / "bus.log").write_text("(0.0) can0 007#1100000000000000\n(1.0) can0 009#1100000000000000\n")
    assert main(["signals", str(tmp_path / "bus.log"), "--dbc", str(tmp_path / "m.dbc")]) == 0
    shown = capsys.readouterr()
    assert f"message ignored: {name}: " in shown.err
    assert "Y" not in shown.out.split()


AFTER_OTHER = PLAIN.replace("BA_DEF_ BO_", OTHER + "ODD" + "BA_DEF_ BO_")


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (ODD.replace("SG_ Z", "SG_ 2Z") + ODD.replace("9 Odd", "9 Again"), "`SG_` cannot be followed by `2Z"),
        (ODD.replace("BO_ 9 Odd", "BO_ x Odd"), "`BO_` cannot be followed by `x Odd"),
        (ODD.replace('"" A', '" A', 1), '`VAL_ 2566844926 Page 2 "Speed` cannot be followed by'),
    ],
)
def test_what_may_belong_to_another_message_refuses_the_file(tmp_path: Path, odd: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        messages(tmp_path, AFTER_OTHER.replace("ODD", odd))
    assert said in str(refused.value)


def test_signals_below_a_line_that_is_not_seen_as_a_message_s_are_no_one_s(tmp_path: Path) -> None:
    """They would be those of the message before."""
    text = AFTER_OTHER.replace("ODD", ODD.replace("BO_ 9 Odd", "BO_9 Odd"))
    found: dict[str, MessageBits] = messages(tmp_path, text)  # type: ignore[assignment]
    assert {name: list(message.signals) for name, message in found.items()} == {"Shaft": ["Page", "Speed", "Load"], "Other": []}
    assert "`BO_9 Odd: 8 A` is not a line of a DBC file" in found["Other"].contradiction


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504), "is an old Excel file"),
        (b"\x03\x7e\x01\x01" + bytes(28) + b"NAME" + bytes(30), "is a dBase table"),
        (b"PK\x03\x04" + bytes(60), "is a zip archive or workbook"),
        (b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n", "is a PDF"),
        (b"\xef\xbb\xbf<!DOCTYPE html>\n<html>404</html>\n", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d\n", "is a pointer of Git LFS"),
        (PLAIN.encode("utf-16"), "is UTF-16 text"),
        (b"A\x00B", "is not text"),
        (b"id;message;signal\r\n0x123;Force;Value\r\n", "is not a DBC file; expected a DBC file, with lines such as `BO_ 291 "),
        (b"(0.0) can0 123#0011\n", "is not a DBC file"),
        (b"\r\n \r\n", "is empty"),
    ],
)
def test_another_kind_of_file_is_told_as_what_it_is(
    tmp_path: Path, content: bytes, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """cantools told where its grammar ended."""
    (tmp_path / "m.dbc").write_bytes(content)
    (tmp_path / "bus.log").write_text("(0.0) can0 007#1100000000000000\n")
    (tmp_path / "c.yaml").write_text("signals:\n  moisture: {dbc: m.dbc, message: Other, signal: X}\n")
    for words in (
        ["signals", str(tmp_path / "bus.log"), "--dbc", str(tmp_path / "m.dbc")],
        ["check-config", str(tmp_path / "c.yaml")],
    ):
        assert main(words) == 2
        line = capsys.readouterr().err
        assert f"m.dbc: {said}" in line
        assert line.count("\n") == 1
        assert "syntax" not in line


def test_the_line_of_a_mistake_is_that_of_the_file(tmp_path: Path) -> None:
    """Not of what is left of it without the copies of messages."""
    odd = 'CM_ "a plate of 5" steel";'
    text = PLAIN.replace("BA_DEF_ BO_", OTHER + OTHER + "BA_DEF_ BO_").replace("VAL_ 25", f"{odd}\nVAL_ 25")
    with pytest.raises(InputError) as refused:
        messages(tmp_path, text)
    line = 1 + text.split("\n").index('VAL_ 2566844926 Page 2 "Speed" ;')
    assert f": line {line}: `VAL_ " in str(refused.value)
