"""Logs as other makers' loggers write them: excerpts by others (tests/data/loggers), and forms made here where there is none."""

from __future__ import annotations

import gzip
import json
import re
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest

from tests.bus.log_files import read
from tests.whole_logs import load_frames
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli.main import main
from yieldmon.errors import InputError

LOGGERS = Path(__file__).parents[1] / "data" / "loggers"
START_S = datetime(2023, 8, 14, 9, 15, 2, tzinfo=UTC).timestamp()

KVASER = """CSV CAN data
Converted from Kvaser Memorator at,2023-08-14 16:02:11

Format of data field,{data}
Format of id field,{id}
Timestamp Offset,             0.00000,seconds
Logging started at,2023-08-14 09:15:02
Time,Channel,id,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter,AbsTime
"""
BUSMASTER = """***BUSMASTER Ver 1.6.4***
***PROTOCOL {protocol}***
***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***
***[START LOGGING SESSION]***
***START DATE AND TIME 14:8:2023 {start}***
***{base}***
***{mode} MODE***
"""
CLX000 = """# Logger type: CL2000
# HW rev: 6.xx
# Time: 20230814T091502
# Value separator: ";"
# Time format: 4
# Time separator: ""
# Time separator ms: ""
# Date separator: ""
# Time and date separator: "T"
# Bit-rate: 250000
Timestamp;Type;ID;Data
"""
CANKING = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
_SPY_ROW = "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node"
VEHICLE_SPY = f"""Vehicle Spy 3 Bus Traffic File
Start Date,8/14/2023
Start Time,9:15:02 AM

Network Description,Hardware,Network,Protocol,Baud Rate
HS CAN,Default,HS CAN,CAN,250000,

{_SPY_ROW},Arb ID,Remote/EDL-BRS-ESI,Xtd,B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals
{_SPY_ROW},PT,Trgt,Src,B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals
"""


def written(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


@pytest.mark.parametrize(
    ("name", "frames", "errors", "first", "last"),
    [
        ("savvycan_gvret.csv", 40, 0, (166.064, 0x21A, False, "FE3612FE690507AD"), None),
        ("busmaster.log", 27, 0, (1443046814.992, 0x21A, False, "FE3612FE690507AD"), None),
        ("canedge.csv", 79, 0, (1581670628.16155, 0x123, False, ""), None),
        ("peak_1_0.trc", 4, 1, (1.841, 1, False, "0000000000000000"), (1.845, 0x300, False, "0000000000000000")),
        ("peak_1_1.trc", 6, 1, (1048510353.543897, 0x300, False, "00000000040000"), None),
        ("peak_1_2.trc", 6, 1, (1236356113.377202, 0x300, False, "00000000040000"), None),
        ("peak_1_3.trc", 5, 1, (1649159855.830352, 0x401, False, "0000000000000000"), None),
        ("peak_2_0.trc", 8, 1, (1437731217.674896, 0x300, False, "00000000040000"), None),
        ("peak_2_1.trc", 9, 2, (1399460968.107754, 0x300, False, "00000000040000"), None),
    ],
)
def test_logs_by_others_are_read_whole(name: str, frames: int, errors: int, first: tuple, last: tuple | None) -> None:
    messages, notes = read(LOGGERS / name)
    assert (len(messages), notes.error_frames, notes.damages) == (frames, errors, [])
    for expected, message in ((first, messages[0]), (last, messages[-1])):
        if expected is not None:
            time_s, *rest = expected
            assert message.timestamp == pytest.approx(time_s, abs=2e-6)
            assert [message.arbitration_id, message.is_extended_id, message.data.hex().upper()] == rest


@pytest.mark.parametrize("name", sorted(path.name for path in LOGGERS.iterdir() if path.suffix != ".md"))
def test_blocks_hold_the_same_frames_gzipped_as_well(tmp_path: Path, name: str) -> None:
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress((LOGGERS / name).read_bytes()))
    messages, notes = read(LOGGERS / name)
    counted = LogNotes()
    for path in (LOGGERS / name, packed):
        block = load_frames(path, counted)
        assert block.time_s.tolist() == [message.timestamp for message in messages]
        assert (block.can_id & 0x1FFFFFFF).tolist() == [message.arbitration_id for message in messages]
    assert (counted.frames, counted.error_frames) == (2 * notes.frames, 2 * notes.error_frames)


def test_what_frames_of_other_kinds_are_in_the_excerpts() -> None:
    canedge = read(LOGGERS / "canedge.csv")[0]
    assert {message.channel for message in canedge} == {1}
    assert {(message.is_fd, message.bitrate_switch) for message in canedge} == {(False, False), (True, False), (True, True)}
    assert max(len(message.data) for message in canedge) == 64
    assert [m.is_extended_id for m in canedge if m.arbitration_id == 0x12345678] == [True] * 38
    trace = read(LOGGERS / "peak_2_0.trc")[0]
    assert [message.is_rx for message in trace] == [True, True, False, True, False, True, False, True]
    assert [(message.is_fd, len(message.data)) for message in trace][4] == (True, 12)
    assert [message.is_remote_frame for message in trace][-1] is True
    assert (trace[-2].arbitration_id, trace[-2].is_extended_id) == (0x18EFC034, True)


@pytest.mark.parametrize(("ids", "data"), [("HEX", "HEX"), ("DEC", "DEC"), ("DEC", "HEX"), ("HEX", "DEC")])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_kvaser_says_its_bases_itself(tmp_path: Path, ids: str, data: str, separator: str) -> None:
    number = {"HEX": "{:x}", "DEC": "{:d}"}
    byte = {"HEX": "{:02x}", "DEC": "{:d}"}[data]
    payload = bytes((128, 62, 0, 255, 255, 255, 255, 16))
    cells = [byte.format(one) for one in payload]
    clock = "2023-08-14 09:15:02"
    rows = [
        ["0.00251", "1", number[ids].format(0x18FF0117), "4", "8", *cells, "1", clock],
        ["0.00252", "2", number[ids].format(0x123), "66", "2", *cells[:2], *[""] * 6, "2", clock],
        ["0.00260", "1", "", "34", "", *[""] * 8, "3", clock],
        ["0.00270", "1", number[ids].format(0x321), "3", "4", *[""] * 8, "4", clock],
        ["0.00280", "1", number[ids].format(0x322), "130", "1", cells[0], *[""] * 7, "5", clock],
        ["0.00290", "1", number[ids].format(0x7FF), str(2 + 0x400), "0", *[""] * 8, "6", clock],
    ]
    text = KVASER.format(id=ids, data=data).replace(",", separator) + "".join(separator.join(row) + "\n" for row in rows)
    if separator == ";":
        text = text.replace("0.00", "0,00")
    messages, notes = read(written(tmp_path, "memorator.csv", text))
    assert (notes.damages, notes.error_frames, notes.dropped_by_recorder) == ([], 1, 1)
    first, sent, error, remote, last = messages
    assert (first.arbitration_id, first.is_extended_id, bytes(first.data)) == (0x18FF0117, True, payload)
    assert first.timestamp == pytest.approx(START_S + 0.00251, abs=1e-6)
    assert (sent.arbitration_id, sent.is_extended_id, sent.is_rx, sent.channel) == (0x123, False, False, 2)
    assert (error.is_error_frame, remote.is_remote_frame, remote.dlc) == (True, True, 4)
    assert last.arbitration_id == 0x7FF


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (KVASER.format(id="HEX", data="HEX").replace(",id,", ",PGN,").replace("of id", "of PGN"), "parameter groups in place of"),
        (KVASER.format(id="HEX", data="HEX").replace("Format of id field,HEX\n", ""), "does not say whether identifiers"),
        ("CSV CAN data\n" + "x\n" * 50, "no line begins Time, Channel"),
        ("TimestampEpoch;BusChannel;ID;IDE;DLC\n1.0;1;123;0;0\n", "lacks the column DataLength"),
        (
            "timestamps,CAN_DataFrame.BusChannel,CAN_DataFrame.ID,CAN_DataFrame.IDE,CAN_DataFrame.DLC,CAN_DataFrame.DataLength,"
            "CAN_DataFrame.DataBytes\n0.1,1,421,0,8,8,[1 2 3 4 5 6 7 8]\n0.2,1,421,0,8,12,[11 22 33 44 55 66 7 8]\n",
            "columns 'timestamps,CAN_DataFrame.BusChannel",
        ),
        ("Time,Id,Data\n0.1,123,AA BB\n", "of python-can, SavvyCAN, Kvaser, CANedge or Vehicle Spy"),
        ('"No.","Time","Source"\n"1","0.0","CAN"\n', 'columns \'"No.","Time","Source"\' of another program'),
        ("time,addr,bus,data\n0.1,0x119,0,0011\n", "columns 'time,addr,bus,data' of another program"),
        ("timestamp,iface,can_id,dlc,data\n0.1,can0,21,1,AA\n", "columns 'timestamp,iface,can_id,dlc,data' of another program"),
    ],
)
def test_csv_that_cannot_be_read_is_refused_in_one_line(tmp_path: Path, text: str, problem: str, capsys) -> None:
    path = written(tmp_path, "logger.csv", text)
    with pytest.raises(InputError, match=problem):
        read(path)
    assert main(["process", str(path), "--out", str(tmp_path / "out.csv")]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert [problem in line for line in told] == [True]


@pytest.mark.parametrize(
    ("mode", "base", "start", "times", "expected_s"),
    [
        ("ABSOLUTE", "DEC", "9:15:2:0", ("00:00:01:2541", "00:00:01:2548"), (1.2541, 1.2548)),
        ("ABSOLUTE", "HEX", "9:15:2:0", ("94:00:00:0000", "94:00:01:0000"), (94 * 3600.0, 94 * 3600.0 + 1)),
        ("RELATIVE", "HEX", "9:15:2:0", ("00:00:00:0000", "00:00:00:0013", "00:00:00:0980"), (0.0, 0.0013, 0.0993)),
        ("SYSTEM", "DEC", "9:15:2:0", ("09:15:03:5000", "09:15:03:5010"), (1.5, 1.501)),
        # The clock of the log's name and that of its frames differ by seconds; no frame is a day late for that.
        ("SYSTEM", "HEX", "9:15:2:0", ("09:14:40:0000", "09:14:41:0000"), (-22.0, -21.0)),
        ("SYSTEM", "HEX", "23:59:59:0", ("23:59:59:9000", "00:00:00:1000", "00:00:01:0000"), (53097.9, 53098.1, 53099.0)),
    ],
)
def test_times_of_busmaster(tmp_path: Path, mode: str, base: str, start: str, times: tuple, expected_s: tuple) -> None:
    identifier, data = {"HEX": ("0x6D6", "0A FF"), "DEC": ("1750", "010 255")}[base]
    text = BUSMASTER.format(protocol="CAN", start=start, base=base, mode=mode)
    text += "".join(f"{time} Tx 1 {identifier} s 2 {data}\n" for time in times) + "***[STOP LOGGING SESSION]***\n"
    messages, notes = read(written(tmp_path, "busmaster.log", text))
    assert notes.damages == []
    assert [m.timestamp - START_S for m in messages] == pytest.approx(expected_s, abs=2e-6)
    assert {(m.arbitration_id, bytes(m.data), m.is_rx) for m in messages} == {(0x6D6, b"\x0a\xff", False)}


def test_busmaster_sessions_kinds_and_another_protocol(tmp_path: Path) -> None:
    can_log = BUSMASTER.format(protocol="CAN", start="9:15:2:0", base="HEX", mode="ABSOLUTE")
    can_log += "00:00:01:0000 Rx 1 0xD83CEB3 x 2 00 01\n00:00:02:0000 Rx 2 0x136 sr 8\n"
    path = written(tmp_path, "two.log", can_log + can_log.replace("9:15:2:0", "9:16:2:0"))
    messages, notes = read(path)
    assert notes.damages == []
    assert [m.timestamp - START_S for m in messages] == [1.0, 2.0, 61.0, 62.0]
    assert [(m.is_extended_id, m.is_remote_frame) for m in messages[:2]] == [(True, False), (False, True)]
    other = BUSMASTER.format(protocol="J1939", start="9:15:2:0", base="HEX", mode="SYSTEM")
    with pytest.raises(InputError, match="protocol J1939; expected protocol CAN"):
        read(written(tmp_path, "j1939.log", other + "14:24:01:3995 1 1ceaff00 0x00EA00 RQST_ACL 00  FF  007 Tx 3 00 EE 00\n"))


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        (("01T00:00:00.100", "01T00:00:01.100"), ("2017-02-01 00:00:00.100", "2017-02-01 00:00:01.100")),
        # The header's clock may be a little ahead of the first frame, over a day, month or year.
        (("31T235959900", "01T000000100"), ("2017-01-31 23:59:59.900", "2017-02-01 00:00:00.100")),
        (
            ("235959900", "000000100", "000000050"),
            ("2017-01-31 23:59:59.900", "2017-02-01 00:00:00.100", "2017-02-01 00:00:00.050"),
        ),
        (("20160228T235959900", "000000100"), ("2016-02-28 23:59:59.900", "2016-02-29 00:00:00.100")),
        (("20161231T235959900", "01T000000100"), ("2016-12-31 23:59:59.900", "2017-01-01 00:00:00.100")),
    ],
)
def test_times_of_clx000(tmp_path: Path, times: tuple, expected: tuple) -> None:
    text = CLX000.replace("20230814T091502", "20170201T000000") + "".join(f"{time};8;7df;0201\n" for time in times)
    messages, notes = read(written(tmp_path, "0000001.TXT", text))
    assert notes.damages == []
    assert [f"{datetime.fromtimestamp(m.timestamp, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3] for m in messages] == list(expected)


def test_columns_of_clx000(tmp_path: Path) -> None:
    text = CLX000.replace('separator: ";"', 'separator: ","').replace(
        "Timestamp;Type;ID;Data", "Timestamp,Lost,Type,ID,Length,Data"
    )
    text += "14T091502100,0,1,18fef117,2,0AFF\n14T091502200,3,9,117,0,\n14T091502300,0,8,7df,1,55\n14T091502400,0,0,7df,1,55\n"
    messages, notes = read(written(tmp_path, "0000001.txt", text))
    assert (notes.damages, notes.dropped_by_recorder) == ([], 3)
    assert [(m.arbitration_id, m.is_extended_id, m.is_rx, bytes(m.data)) for m in messages] == [
        (0x18FEF117, True, True, b"\x0a\xff"), (0x117, True, False, b""),
        (0x7DF, False, False, b"\x55"), (0x7DF, False, True, b"\x55"),
    ]  # fmt: skip


def test_frames_of_other_kinds_of_canking_and_vehicle_spy(tmp_path: Path) -> None:
    lines = (
        " 0    0CFBFFDB X       8  1B  31  20  EB  B3  FF  D9  FF     100.000139 R\n"
        " 1    00000065         2  01  00                             101.500000 T\n"
        " 0    00000066 R       4                                     101.600000 R\n"
        " 0    00000000            ErrorFrame                         102.095270 R\n"
    )
    messages, notes = read(written(tmp_path, "canking.log", CANKING + lines + "Logging stopped.\n"))
    assert notes.damages == []
    assert [(m.arbitration_id, m.is_extended_id, m.is_rx, m.dlc, m.channel) for m in messages[:3]] == [
        (0xCFBFFDB, True, True, 8, 0), (0x65, False, False, 2, 1), (0x66, False, True, 4, 0),
    ]  # fmt: skip
    assert (messages[2].is_remote_frame, messages[3].is_error_frame) == (True, True)
    row = "1,2550.5,0.1,67,F,T,MS CAN $119,MS CAN,,119,F,T,0A,FF,,,,,,,,,\n"
    messages, notes = read(written(tmp_path, "spy.csv", VEHICLE_SPY + row + row.replace(",F,T,MS", ",T,F,MS")))
    assert notes.damages == []
    [sent, error] = messages
    assert (sent.timestamp, sent.channel, sent.is_extended_id, sent.is_rx, bytes(sent.data)) == (
        2550.5,
        "MS CAN",
        True,
        False,
        b"\x0a\xff",
    )
    assert (error.timestamp, error.is_error_frame) == (2550.5, True)


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("a.txt", CLX000.replace("# Time: 20230814T091502\n", "") + "01T000000000;0;1;00\n", "no line of the header says when"),
        ("a.txt", CLX000.replace(";ID", "") + "01T000000000;0;00\n", "lacks the column ID"),
        ("a.txt", CLX000 + "2000;0;7df;00\n", "time '2000' is not hours, minutes"),
        ("a.txt", CLX000 + "45T000000000;0;7df;00\n", "time 45000000 is not in the calendar"),
        ("a.txt", CLX000.replace("202308", "999912") + "45T000000000;0;7df;00\n", "time 45000000 is not in the calendar"),
        ("a.txt", CLX000 + "01T000000000;2;7df;00\n", "type '2' is not 0, 1, 8 or 9"),
        ("a.txt", CANKING + " 0        331         2   1  255       101.5 R\n", "not a CanKing frame with hexadecimal numbers"),
        ("a.txt", CANKING + " 0    00000065 Q       1  01           101.5 R\n", "flags 'Q' are not known"),
        ("a.csv", VEHICLE_SPY.replace("Arb ID", "ID") + "1,0.5,0,67,F,F,-,HS,,119,F,F,0A,,,,,,,,,,\n", "no heading above names"),
        ("a.csv", VEHICLE_SPY + "1,0.5,0,67,F,F,-,J1939,,F004,FF,00,0A,,,,,,,,,,\n", "not a classic CAN frame"),
        ("a.csv", VEHICLE_SPY + "1,0.5,0,67,F,F\n", "6 fields; expected more"),
        ("a.txt", "1320745424.002 R11 402 FA 01\n", "'1320745424.002 R11 402 FA 01' is not a candump line; no frame in"),
    ],
)  # fmt: skip
def test_what_is_no_frame_of_these_loggers_is_named(tmp_path: Path, name: str, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=re.escape(problem)):
        read(written(tmp_path, name, text))


@pytest.mark.parametrize(
    ("name", "old", "new", "problem"),
    [
        ("savvycan_gvret.csv", ",false,0,8,67,01,5E,", ",false,0,8,67,01", "byte 285 is above 255"),
        ("savvycan_gvret.csv", "0000022A", "0000x22A", "identifier '0000x22A' is not a hexadecimal number"),
        ("savvycan_gvret.csv", "166064000,0000022A", "9" * 400 + ",0000022A", "is not a number"),
        ("canedge.csv", "1581670628.161750;", "nan;", "time 'nan' is not a number"),
        ("canedge.csv", "1581670628.161750;", "1e400;", "time '1e400' is not a number"),
        ("canedge.csv", ";1;1;0;0;0;12\n", ";1;1;0;0;0;1\n", "not hexadecimal bytes"),
        ("canedge.csv", ";2;2;0;0;0;1234\n", ";2;2;0;0;0;12\n", "1 bytes of data where the length says 2"),
        ("busmaster.log", "0000021A s 8 FE 36", "0000021A s 8 36", "7 bytes of data where the length says 8"),
        ("peak_1_3.trc", "Rx        0401", "Qx        0401", "type 'Qx' is not known"),
        ("peak_2_1.trc", "DT 1 0400 Tx - 2 00 00", "DT 1 0400 Tx - 2 00", "1 bytes of data where the length says 2"),
    ],
)
def test_a_damaged_line_costs_itself(tmp_path: Path, name: str, old: str, new: str, problem: str) -> None:
    text = (LOGGERS / name).read_text(encoding="utf-8")
    assert old in text
    whole, (messages, notes) = read(LOGGERS / name)[0], read(written(tmp_path, name, text.replace(old, new, 1)))
    assert len(messages) == len(whole) - 1
    assert [problem in damage.problem for damage in notes.damages] == [True]


@pytest.mark.parametrize(
    ("version", "problem"), [("9.9", "version 9.9; expected 1.0 to 2.1"), ("2.1", "does not name its columns")]
)
def test_traces_that_cannot_be_read_are_refused(tmp_path: Path, version: str, problem: str) -> None:
    text = f";$FILEVERSION={version}\n;\n      1      1059.900 DT 1      0300 Rx -  1    00\n"
    with pytest.raises(InputError, match=problem):
        read(written(tmp_path, "drive.trc", text))


def _savvycan(m: can.Message) -> str:
    cells = ",".join(f"{byte:02X}" for byte in m.data.ljust(8, b"\0"))
    return f"{round(m.timestamp * 1e6)},{m.arbitration_id:08X},{str(m.is_extended_id).lower()},Rx,0,{m.dlc},{cells},"


def _canedge(m: can.Message) -> str:
    kind = f"{int(m.is_extended_id)};{m.dlc};{m.dlc};0;0;0;0;0"
    return f"{m.timestamp:.6f};1;{m.arbitration_id:X};{kind};{m.data.hex().upper()}"


def _kvaser(m: can.Message) -> str:
    cells = [str(byte) for byte in m.data] + [""] * (8 - m.dlc)
    flags = 4 if m.is_extended_id else 2
    return ",".join([f"{m.timestamp - START_S:.6f}", "1", str(m.arbitration_id), str(flags), str(m.dlc), *cells, "7", "-"])


def _clx000(m: can.Message) -> str:
    time = datetime.fromtimestamp(m.timestamp, UTC).strftime("%dT%H%M%S%f")[:-3]
    return f"{time};{int(m.is_extended_id)};{m.arbitration_id:x};{m.data.hex()}"


def _canking(m: can.Message) -> str:
    mark = "X" if m.is_extended_id else " "
    return f" 0    {m.arbitration_id:08X} {mark}       {m.dlc}  {m.data.hex(' ').upper()}  {m.timestamp - START_S:.6f} R"


def _vehicle_spy(m: can.Message) -> str:
    cells = [f"{byte:02X}" for byte in m.data] + [""] * (8 - m.dlc)
    mark, name = "FT"[m.is_extended_id], f"{m.arbitration_id:X}"
    row = f"1,{m.timestamp - START_S:.9f},0,67371008,F,F,HS CAN ${name},HS CAN,,{name},F,{mark},"
    return row + ",".join([*cells, "", "", ""])


def _busmaster(m: can.Message) -> str:
    tenths = round((m.timestamp - START_S) * 1e4)
    clock = f"{tenths // 36_000_000:02d}:{tenths // 600_000 % 60:02d}:{tenths // 10_000 % 60:02d}:{tenths % 10_000:04d}"
    return f"{clock} Rx 1 0x{m.arbitration_id:X} {'x' if m.is_extended_id else 's'} {m.dlc} {m.data.hex(' ').upper()}"


_FORMS = {
    "savvycan.csv": ("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n", _savvycan),
    "canedge.csv": ("TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes\n", _canedge),
    "kvaser.csv": (KVASER.format(id="DEC", data="DEC"), _kvaser),
    "vehicle_spy.csv": (VEHICLE_SPY, _vehicle_spy),
    "0000001.TXT": (CLX000, _clx000),
    "canking.txt": (CANKING, _canking),
    "busmaster.log": (BUSMASTER.format(protocol="CAN", start="9:15:2:0", base="HEX", mode="ABSOLUTE"), _busmaster),
}


@pytest.fixture(scope="module")
def harvest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("harvest")
    command = ["simulate", "--duration", "25", "--seed", "5", "--start-time", f"{START_S:.0f}", "--log", str(folder / "day.log")]
    assert main(command) == 0
    return folder / "day.log"


@pytest.mark.parametrize("name", list(_FORMS))
def test_a_harvest_measures_the_same_from_any_logger(tmp_path: Path, harvest: Path, name: str) -> None:
    heading, line = _FORMS[name]
    path = written(tmp_path, name, heading + "".join(line(message) + "\n" for message in read_log(harvest)))
    tables = []
    for log in (harvest, path):
        out = tmp_path / f"{log.stem}-out.csv"
        assert main(["process", str(log), "--out", str(out)]) == 0
        tables.append(np.genfromtxt(out, delimiter=",", names=True, dtype=None, encoding="utf-8"))
    assert len(tables[0]) == len(tables[1]) >= 20
    ours, theirs = (table["mass_flow_kg_s"] for table in tables)
    begins = int(np.argmax(np.isfinite(ours)))
    np.testing.assert_allclose(np.delete(theirs, begins), np.delete(ours, begins), rtol=2e-4, atol=1e-3)
    # Where grain begins, a sample that a rounded time puts into the next paddle pattern counts there.
    assert theirs[begins] == pytest.approx(ours[begins], rel=2e-3)
    since_s = 0.0 if tables[1]["time_s"][0] > 1e9 else START_S
    np.testing.assert_allclose(tables[1]["time_s"] + since_s, tables[0]["time_s"], atol=2e-4)


VECTOR = """date Sam Sep 30 10:06:13.191 PM 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sam Sep 30 10:06:13.191 PM 2017
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error active
   0.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   1.015991 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.04%
   2.501000 1  ErrorFrame
   2.501010 1  ErrorFrame       ECC: 10100010
   2.510001 2  100              Rx   d 8 00 01 02 03 04 05 06 07  Length = 0 BitCount = 64 ID = 256
   2.520002 3  200              Tx   r
   3.097000 1  J1939TP FEE3p 6   0   0 - Rx  d 23 A0 0F A6 60 3B D1 40 1F DE 80 25 DF C0 2B E1 00 4B FF FF 3C
   3.148421 1  18EBFF00x        Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
   4.876870 CANFD   1 Rx        300                  Generic_Name_12 1 0 8 8 01 02 03 04 05 06 07 08  102203  133 303000 e0006659
   5.000000 SV: 2 0 1 ::Sys::Speed = 2
   6.113476 log trigger event
End TriggerBlock
"""


def test_every_line_of_vectors_that_should_be_a_frame_is_one_or_is_reported(tmp_path: Path) -> None:
    """A line that is damaged in its time, identifier or direction is no event of another kind."""
    notes = LogNotes()
    path = written(tmp_path, "sound.asc", VECTOR)
    assert len(list(read_log(path, notes))) == 6
    assert notes.damages == []
    lost = {
        "2.510001 2": "2?,510001 2", "   2.520002 3": "(1790000000.004000) can1 2A1#00F8", "Rx   d 8 01 A0": "R?   d 8 01 A0",
        "   2.501000 1  E": "2,501000 1  E",
    }  # fmt: skip
    for sound, damaged in lost.items():
        notes = LogNotes()
        path = written(tmp_path, "damaged.asc", VECTOR.replace(sound, damaged))
        assert len(list(read_log(path, notes))) == 5
        assert len(notes.damages) == 1
        assert notes.damages[0].problem.endswith("is not a frame of .asc")


@pytest.mark.parametrize("base", ["hex", "dec"])
def test_messages_of_vector_logged_by_name_have_the_number_behind_their_data(tmp_path: Path, base: str) -> None:
    """EEC1x was read as the identifier 0xEEC1, in silence."""
    rows = [
        f"base {base}  timestamps absolute",
        "   0.010000 1  EEC1x    Rx   d 2 01 02  Length = 551804 BitCount = 142 ID = 217056256x",
        "   0.020000 1  VEP1x    Rx   d 2 01 02  Length = 551804 BitCount = 142 ID = 419362560x",
        "   0.030000 1  FACE     Rx   d 2 01 02  Length = 551804 BitCount = 142 ID = 290",
        "   0.040000 1  Wheels   Tx   r",
    ]
    notes = LogNotes()
    path = written(tmp_path, "names.asc", "\n".join(rows) + "\n")
    found = [(message.arbitration_id, message.is_extended_id) for message in read_log(path, notes)]
    assert found == [(0x0CF00400, True), (0x18FEF700, True), (290, False)]
    assert [str(damage) for damage in notes.damages] == [f"{path}:5: 'Wheels' is a message's name; log identifiers as numbers"]


@pytest.mark.parametrize("base", ["hex", "dec"])
def test_times_of_vector_since_the_line_before(tmp_path: Path, base: str) -> None:
    identifier = {"hex": "18FF1380x", "dec": "419369856x"}[base]
    rows = [
        "date Wed Jul 1 10:00:00.000 am 2026",
        f"base {base}  timestamps relative",
        "internal events logged",
        "Begin Triggerblock Wed Jul 1 10:00:00.000 am 2026",
        "   0.000000 Start of measurement",
        f"   0.250000 1  {identifier}       Rx   d 2 01 02",
        "   0.500000 CAN 1 Status:chip status error active",
        f"   1.000000 1  {identifier}       Rx   d 2 01 03",
        f"   0.000001 1  {identifier}       Rx   d 2 01 04",
        "End TriggerBlock",
    ]
    path = tmp_path / "drive.asc"
    path.write_text("\n".join(rows) + "\n")
    start_s = datetime(2026, 7, 1, 10, tzinfo=UTC).timestamp()
    assert [(round(m.timestamp - start_s, 6), m.arbitration_id, m.data[1]) for m in read_log(path)] == [
        (0.25, 0x18FF1380, 2), (1.75, 0x18FF1380, 3), (1.750001, 0x18FF1380, 4),
    ]  # fmt: skip
    path.write_text("\n".join(rows).replace("relative", "absolute") + "\n")
    assert [round(m.timestamp - start_s, 6) for m in read_log(path)] == [0.25, 1.0, 0.000001]


@pytest.mark.parametrize(
    ("header", "starts"),
    [
        ("date Sam Mär 7 10:06:13.191 PM 2026", (2026, 3, 7, 22, 6, 13, 191_000)),
        ("date Thu Dez 31 12:00:00 am 2026", (2026, 12, 31, 0, 0, 0)),
        ("date Mon Sep 21 14:13:51.688 2026", (2026, 9, 21, 14, 13, 51, 688_000)),
        # Written later than the first frame came, as python-can does.
        (
            "date Fri Nov 27 11:57:02.432 2026\nBegin Triggerblock Mon Sep 21 14:13:51.688 2026\n 0.000000 Start of measurement",
            (2026, 9, 21, 14, 13, 51, 688_000),
        ),
        ("date Mon Sep 21 14:13:51.4 2026", (2026, 9, 21, 14, 13, 51, 4_000)),
        # Triggered a minute after the measurement began.
        ("date Fri Nov 27 11:57:02 2026\nBegin Triggerblock Fri Nov 27 11:58:02 2026", (2026, 11, 27, 11, 57, 2)),
        ("date Mo Mrz 2 02:13:20.500 nachm. 2026", (2026, 3, 2, 14, 13, 20, 500_000)),
        ("date Mo Jän 5 12:13:20 vorm. 2026", (2026, 1, 5, 0, 13, 20)),
        # As BUSMASTER's converter writes it.
        ("date Thu Mar 28 11:8:4 am 2024", (2024, 3, 28, 11, 8, 4)),
        ("date Xyz Ventôse 3 10:00:00 2026", None),
        ("date 2026-09-21 14:13:20", None),
        ("base hex  timestamps absolute", None),
        ("date", None),
    ],
)
def test_times_of_vector_from_its_date(tmp_path: Path, header: str, starts: tuple[int, ...] | None) -> None:
    path = written(tmp_path, "dated.asc", f"{header}\n   61.250000 1  123  Rx   d 1 07\n")
    start_s = datetime(*starts, tzinfo=UTC).timestamp() if starts is not None else 0.0  # type: ignore[arg-type,misc]
    notes = LogNotes()
    (message,) = read_log(path, notes)
    assert message.timestamp == pytest.approx(start_s + 61.25, abs=1e-5)
    # A date in other words was passed over in silence.
    not_understood = [damage.where for damage in notes.damages if "is not understood" in damage.problem]
    assert not_understood == [f"{path}:1"] * (starts is None and any(map(str.isdigit, header)))


def test_parts_of_a_rotated_log_are_one_record_whatever_their_names_are(
    tmp_path: Path, harvest: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """python-can's SizedRotatingLogger leaves the last part under the name that sorts first; each part's times begin at 0."""
    parts = [tmp_path / "drive_#000.asc", tmp_path / "drive_.asc"]
    messages = list(read_log(harvest))
    half = len(messages) // 2
    for path, some in zip(parts, (messages[:half], messages[half:]), strict=True):
        with can.ASCWriter(path) as writer:
            for one in some:
                writer.on_message_received(one)
    summaries = []
    for logs in ([harvest], [parts[1], parts[0]]):
        capsys.readouterr()
        assert main(["process", *map(str, logs), "--out", str(tmp_path / "out.csv"), "--json", "--force"]) == 0
        summaries.append(json.loads(capsys.readouterr().out))
    assert summaries[1]["total_mass_kg"] == pytest.approx(summaries[0]["total_mass_kg"], rel=1e-3)
    assert (summaries[1]["faults"], summaries[1]["overlap_s"]) == ({}, 0.0)


def test_frames_of_canedge_as_vectors_are_all_there(tmp_path: Path) -> None:
    """Its header has two lines, and CAN FD frames stand there like classic ones, their length code in decimals. Source: tests of
    CSS-Electronics/mdf4-converters, MIT."""
    eight = " ".join(f"{number:02X}" for number in range(8))
    lines = [
        "date Fri Feb 14 08:51:20 am 2020",
        "base hex  timestamps absolute",
        "  348.161550 1 12345678x Rx d 2 12 34",
        "  348.174000 1 123  Rx d 0 ",
        f"  348.174650 1 123  Rx d 9 {eight} 08 09 0A 0B",
        f"  348.178150 1 123  Rx d 12 {eight} {eight} {eight}",
        f"  348.185950 1 123  Tx d 15 {' '.join([eight] * 8)}",
        f"  348.186950 1 3FF  Rx d D {eight}  Length = 232016 BitCount = 119 ID = 1023",
        f"  348.187950 1 3FF  TxRq d 8 {eight}",
        f"  348.188950 1 3FF  Rx d 12 {eight}",
    ]
    notes = LogNotes()
    found = list(read_log(written(tmp_path, "edge.asc", "\n".join(lines) + "\n"), notes))
    assert [(m.arbitration_id, len(m.data), m.dlc, m.is_fd) for m in found] == [
        (0x12345678, 2, 2, False), (0x123, 0, 0, False), (0x123, 12, 12, True), (0x123, 24, 24, True), (0x123, 64, 64, True),
        (0x3FF, 8, 8, False),
    ]  # fmt: skip
    assert [m.is_rx for m in found] == [True, True, True, True, False, True]
    assert [damage.problem for damage in notes.damages] == ["8 bytes of data where the length says 12"]


def test_a_classic_frame_of_a_fd_channel_is_one(tmp_path: Path) -> None:
    line = "   4.876870 CANFD   1 Rx        300   {} 0 0 8 8 01 02 03 04 05 06 07 08  102203  133 {} e0006659\n"
    text = line.format("", "303000") + line.format("Name_12", "200040")
    found = list(read_log(written(tmp_path, "fd.asc", text)))
    assert [(m.is_fd, m.arbitration_id, bytes(m.data)) for m in found] == [
        (is_fd, 0x300, bytes(range(1, 9))) for is_fd in (True, False)
    ]
