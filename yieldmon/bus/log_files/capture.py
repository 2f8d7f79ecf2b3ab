"""Captures of Wireshark, tcpdump and dumpcap on SocketCAN: pcap and pcapng.

Sources: IETF drafts draft-ietf-opsawg-pcap and -pcapng; the link types LINKTYPE_CAN_SOCKETCAN, LINUX_SLL and LINUX_SLL2 of
tcpdump.org, of which the latter two are what a capture of all interfaces has.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import can

from yieldmon.bounded import opened
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

SUFFIXES = (".pcap", ".pcapng")

_SECTION, _INTERFACE, _SIMPLE, _PACKET = 0x0A0D0D0A, 1, 3, 6
_BYTE_ORDER = 0x1A2B3C4D
_TICKS_PER_S = {0xA1B2C3D4: 10**6, 0xA1B23C4D: 10**9}
"""By the first four bytes of a pcap."""
_LARGEST_BYTES = 1 << 20
"""Of a block; a frame has under a hundred."""
_IF_NAME, _IF_TSRESOL, _IF_TSOFFSET = 2, 9, 14
_SOCKETCAN, _SLL, _SLL2 = 227, 113, 276
_HEADS = {_SOCKETCAN: (0, None), _SLL: (16, 14), _SLL2: (20, 0)}
"""Link type -> bytes before the frame, and where its protocol is among them."""
_CAN_PROTOCOLS = (0x000C, 0x000D)
_FRAME = struct.Struct(">IBBH")
_BIT_RATE_SWITCH, _ERROR_STATE, _FD = 0x01, 0x02, 0x04
_LARGEST_ERROR = 0xFFFF
"""Kinds of errors in an identifier; Linux knows those up to 0x200."""
_XL = 0x80
"""In the place of a length."""


class _Interface(NamedTuple):
    link: int
    name: str | None = None
    ticks_per_s: int = 10**6
    offset_s: int = 0


class Capture:
    """Iterable of the frames; `stop` closes the file. Raises ValueError where it cannot be read further, or is not of a CAN
    bus; what else a capture of all interfaces has is passed over."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when the file cannot be opened."""
        self.file = opened(path)

    def __iter__(self) -> Iterator[can.Message]:
        head = self._exactly(4)
        for order in "<>":
            magic = struct.unpack(order + "I", head)[0]
            if magic in _TICKS_PER_S:
                yield from self._of_pcap(order, _TICKS_PER_S[magic])
                return
        if head != struct.pack("<I", _SECTION):
            raise ValueError("neither a pcap nor a pcapng")
        yield from self._of_pcapng()

    def stop(self) -> None:
        """Close the file."""
        self.file.close()

    def _of_pcap(self, order: str, ticks_per_s: int) -> Iterator[can.Message]:
        link = struct.unpack(order + "I", self._exactly(20)[16:])[0] & 0xFFFF
        interface = _Interface(_can_link(link))
        while head := self.file.read(16):
            if len(head) < 16:
                raise ValueError("the file ends early")
            seconds, fraction, length, _ = struct.unpack(order + "4I", head)
            if length > _LARGEST_BYTES:
                raise ValueError("a damaged packet")
            message = _message(interface, seconds + fraction / ticks_per_s, self._exactly(length))
            if message is not None:
                yield message

    def _of_pcapng(self) -> Iterator[can.Message]:
        order, interfaces = "<", list[_Interface]()
        start: bytes = struct.pack("<I", _SECTION)
        while start:
            if len(start) < 4:
                raise ValueError("a damaged block")
            (kind,) = struct.unpack(order + "I", start)
            length_field = self._exactly(4)
            if kind == _SECTION:
                mark = self._exactly(4)
                order = "<" if struct.unpack("<I", mark)[0] == _BYTE_ORDER else ">"
                if struct.unpack(order + "I", mark)[0] != _BYTE_ORDER:
                    raise ValueError("a section without its byte order")
                interfaces.clear()
            body = self._body(order, length_field, 4 if kind == _SECTION else 0)
            if kind == _INTERFACE:
                interfaces.append(_interface(order, body))
            elif kind == _SIMPLE:
                raise ValueError("packets without times")
            elif kind == _PACKET:
                message = _of_packet(order, body, interfaces)
                if message is not None:
                    yield message
            start = self.file.read(4)

    def _body(self, order: str, length_field: bytes, read_already: int) -> bytes:
        """A block's content between its two lengths."""
        (length,) = struct.unpack(order + "I", length_field)
        if not 12 + read_already <= length <= _LARGEST_BYTES or length % 4:
            raise ValueError(f"a block of {length} bytes")
        body = self._exactly(length - 12 - read_already)
        if self._exactly(4) != length_field:
            raise ValueError("a block whose two lengths differ")
        return body

    def _exactly(self, count: int) -> bytes:
        found = self.file.read(count)
        if len(found) < count:
            raise ValueError("the file ends early")
        return bytes(found)


def _can_link(link: int) -> int:
    if link not in _HEADS:
        raise ValueError(f"a capture of link type {link}; expected one of a SocketCAN interface, as of `tcpdump -i can0 -w FILE`")
    return link


def _interface(order: str, body: bytes) -> _Interface:
    if len(body) < 8:
        raise ValueError("a damaged interface block")
    found = _Interface(struct.unpack_from(order + "H", body)[0])
    at = 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        value, at = body[at + 4 : at + 4 + length], at + 4 + (length + 3) // 4 * 4
        if code == 0:
            break
        if code == _IF_NAME:
            found = found._replace(name=value.decode("utf-8", errors="replace").rstrip("\0"))
        elif code == _IF_TSRESOL and value:
            found = found._replace(ticks_per_s=2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0])
        elif code == _IF_TSOFFSET and len(value) == 8:
            found = found._replace(offset_s=struct.unpack(order + "q", value)[0])
    return found


def _of_packet(order: str, body: bytes, interfaces: list[_Interface]) -> can.Message | None:
    if len(body) < 20:
        raise ValueError("a damaged packet block")
    number, high, low, length, _ = struct.unpack_from(order + "5I", body)
    if number >= len(interfaces) or 20 + length > len(body):
        raise ValueError("a damaged packet block")
    interface = interfaces[number]
    if len(interfaces) == 1:
        _can_link(interface.link)
    elif interface.link not in _HEADS:
        return None
    ticks = high << 32 | low
    whole_s, rest = divmod(ticks, interface.ticks_per_s)
    return _message(interface, interface.offset_s + whole_s + rest / interface.ticks_per_s, body[20 : 20 + length])


def _message(interface: _Interface, time_s: float, packet: bytes) -> can.Message | None:
    """The frame of a packet; None where it is of another protocol."""
    before, protocol_at = _HEADS[interface.link]
    outgoing, channel = False, interface.name
    if protocol_at is not None:
        if len(packet) < before:
            raise ValueError("a damaged packet")
        if struct.unpack_from(">H", packet, protocol_at)[0] not in _CAN_PROTOCOLS:
            return None
        outgoing = (packet[10] if interface.link == _SLL2 else packet[1]) == 4
        if interface.link == _SLL2:
            # Of all interfaces: each has its number, and no name.
            channel = str(struct.unpack_from(">I", packet, 4)[0])
    if len(packet) < before + _FRAME.size:
        raise ValueError("a packet that is not a CAN frame")
    identifier, length, flags, reserved = _FRAME.unpack_from(packet, before)
    if length & _XL:
        raise ValueError("a CAN XL frame, which is not read")
    data = packet[before + _FRAME.size : before + _FRAME.size + length]
    is_remote, is_error = bool(identifier & REMOTE_FLAG), bool(identifier & ERROR_FLAG)
    if len(data) < length and not is_remote:
        raise ValueError("a frame that is cut off; capture whole packets")
    if is_error and identifier & LARGEST_EXTENDED_ID > _LARGEST_ERROR:
        raise ValueError(
            "identifiers with their bytes in reverse, as `mdf2pcap` writes them; expected the recording that it converts"
        )
    # Behind the length of a classic frame there may be anything: programs that send leave it as it was.
    are_flags = not reserved and not flags & ~(_BIT_RATE_SWITCH | _ERROR_STATE | _FD)
    is_fd = length > CLASSIC_BYTES or (are_flags and bool(flags & _FD))
    is_extended = bool(identifier & EXTENDED_FLAG) and not is_error
    return can.Message(
        timestamp=time_s,
        channel=channel,
        arbitration_id=identifier & (LARGEST_EXTENDED_ID if is_extended or is_error else LARGEST_STANDARD_ID),
        is_extended_id=is_extended,
        is_error_frame=is_error,
        is_remote_frame=is_remote,
        is_fd=is_fd,
        bitrate_switch=is_fd and bool(flags & _BIT_RATE_SWITCH),
        error_state_indicator=is_fd and bool(flags & _ERROR_STATE),
        is_rx=not outgoing,
        dlc=length,
        data=None if is_remote else data,
    )
