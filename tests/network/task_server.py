"""A task controller to test against, written from ISO 11783-10 and independent of the product: bytes in, bytes out.

It keeps what it was sent and checks it as it goes; `complaints` holds what a strict server would object to.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field


def parse_pool(data: bytes, version: int) -> dict[int, tuple[str, dict[str, object]]]:  # noqa: C901, PLR0912 - a branch a table
    """Object id -> (table, attributes). Raises ValueError where the bytes are not a pool."""
    objects: dict[int, tuple[str, dict[str, object]]] = {}
    at = 0

    def take(form: str) -> tuple[int, ...]:
        nonlocal at
        values = struct.unpack_from("<" + form, data, at)
        at += struct.calcsize("<" + form)
        return values

    def skip(length: int) -> bytes:
        nonlocal at
        at += length
        return data[at - length : at]

    def text() -> str:
        (length,) = take("B")
        value = skip(length)
        if len(value) != length or length > 32:
            raise ValueError(f"text of {length} bytes")
        return value.decode("utf-8")

    while at < len(data):
        table = data[at : at + 3].decode("ascii")
        at += 3
        (number,) = take("H")
        if number in objects:
            raise ValueError(f"object {number} twice")
        if table == "DVC":
            values: dict[str, object] = {"designator": text(), "software": text(), "name": take("Q")[0], "serial": text()}
            values["structure"], values["localization"] = skip(7), skip(7)
            if version >= 4:
                skip(take("B")[0])
        elif table == "DET":
            kind = take("B")[0]
            values = {"kind": kind, "designator": text()}
            element, parent, count = take("HHH")
            values |= {"element": element, "parent": parent, "children": list(take("H" * count))}
        elif table == "DPD":
            ddi, properties, triggers = take("HBB")
            values = {"ddi": ddi, "properties": properties, "triggers": triggers, "designator": text(), "shown": take("H")[0]}
        elif table == "DPT":
            ddi, value = take("Hi")
            values = {"ddi": ddi, "value": value, "designator": text(), "shown": take("H")[0]}
        elif table == "DVP":
            offset, scale, decimals = take("ifB")
            values = {"offset": offset, "scale": scale, "decimals": decimals, "unit": text()}
        else:
            raise ValueError(f"table {table!r}")
        objects[number] = (table, values)
    known = set(objects) | {0xFFFF}
    for number, (table, values) in objects.items():
        references = [values["parent"], *values["children"]] if table == "DET" else [values["shown"]] if table[:2] == "DP" else []
        for reference in references:
            if reference not in known:
                raise ValueError(f"object {number} refers to {reference}, which is absent")
    if objects.get(0, ("", {}))[0] != "DVC":
        raise ValueError("object 0 is no device")
    return objects


@dataclass
class TaskServer:
    """One server with one client."""

    version: int = 4
    memory: bool = True
    accepts: int = 0
    """Error code of an activation."""
    stored: bytes = b""
    stored_active: bool = False
    task: bool = False
    silent: bool = False
    answers_version: bool = True
    client_known: bool = False
    client_task_at_s: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    values: list[tuple[float, int, int, int]] = field(default_factory=list)
    """Time, element, DDI, value."""
    refusals: list[tuple[int, int, int, int]] = field(default_factory=list)
    """Element, DDI, error, command."""
    announced: int = 0
    status_due_s: float = 0.0

    def tick(self, now_s: float) -> list[bytes]:
        """Status every 2 s."""
        if self.silent or now_s < self.status_due_s:
            return []
        self.status_due_s = now_s + 2.0
        return [bytes([0xFE, 0xFF, 0xFF, 0xFF, int(self.task), 0, 0, 0xFF])]

    @property
    def label(self) -> bytes:
        if not self.stored:
            return b"\xff" * 7
        return parse_pool(self.stored, self.version)[0][1]["structure"]  # type: ignore[return-value]

    def hear(self, group: int, data: bytes, now_s: float) -> list[bytes]:  # noqa: PLR0911 - one answer a message
        """What it answers to a message of the client."""
        if self.silent:
            return []
        if group == 65037:
            self.client_known = True
            self.said.append("master")
            if data[0] != 1:
                self.complaints.append(f"working set of {data[0]}")
            return [b"\x00" + b"\xff" * 7]
        if group != 51968:
            self.complaints.append(f"group {group}")
            return []
        if not self.client_known:
            self.complaints.append("process data before the working set master")
            return []
        command, kind = data[0] & 0xF, data[0] >> 4
        if command == 15:
            self.client_task_at_s.append(now_s)
            return []
        if command == 0:
            return self._technical(kind, data)
        if command == 1:
            return self._descriptor(kind, data)
        element, ddi = kind | data[1] << 4, data[2] | data[3] << 8
        if command == 3:
            if not self.stored_active:
                self.complaints.append("value before the activation")
            self.values.append((now_s, element, ddi, struct.unpack("<i", data[4:])[0]))
        elif command == 13:
            self.refusals.append((element, ddi, data[4], data[5]))
        else:
            self.complaints.append(f"command {command}")
        return []

    def _technical(self, kind: int, data: bytes) -> list[bytes]:
        self.said.append(f"technical {kind}")
        if kind == 0 and self.answers_version:
            return [bytes([0x10, self.version, 10, 0x01, 0, 0, 0, 0])]
        if kind == 1 and data[2] != 0xFF:
            self.complaints.append("boot time from a client")
        return []

    def _descriptor(self, kind: int, data: bytes) -> list[bytes]:  # noqa: PLR0911 - one answer a message
        self.said.append({0: "structure", 2: "localization", 4: "ask", 6: "transfer", 8: "activate", 10: "delete"}.get(kind, "?"))
        if kind == 0:
            return [b"\x11" + self.label]
        if kind == 2:
            stored = parse_pool(self.stored, self.version)[0][1]["localization"] if self.stored else b"\xff" * 7
            return [b"\x31" + stored]  # type: ignore[operator]
        if kind == 4:
            self.announced = int.from_bytes(data[1:5], "little")
            return [bytes([0x51, 0 if self.memory else 1]) + b"\xff" * 6]
        if kind == 6:
            if len(data) - 1 != self.announced:
                self.complaints.append(f"{len(data) - 1} bytes, {self.announced} announced")
            parse_pool(data[1:], self.version)
            self.stored = data[1:]
            return [b"\x71\x00" + (len(data) - 1).to_bytes(4, "little") + b"\xff\xff"]
        if kind == 8:
            self.stored_active = not self.accepts
            return [bytes([0x91, self.accepts]) + b"\xff" * 4 + b"\x00\xff"]
        if kind == 10:
            self.stored, self.stored_active = b"", False
            return [b"\xb1\x00" + b"\xff" * 6]
        self.complaints.append(f"descriptor {kind}")
        return []

    @staticmethod
    def command(command: int, element: int, ddi: int, value: int = 0) -> bytes:
        """A command about a variable."""
        return bytes([command | (element & 15) << 4, element >> 4]) + struct.pack("<Hi", ddi, value)
