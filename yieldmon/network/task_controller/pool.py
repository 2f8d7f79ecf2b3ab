"""Device descriptor object pools of ISO 11783-10 annex A: a device described to a task controller."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

from yieldmon.network.name import Name

NO_OBJECT = 0xFFFF
LABEL_BYTES = 7
#: English, decimal point, 24 h, metric throughout (ISO 11783-7, language command).
LOCALIZATION = b"en\x40\x00\x00\x00\xff"
#: From this version on the device object carries an extended structure label.
_EXTENDED_LABEL_VERSION = 4


class ElementType(IntEnum):
    """Kinds of device elements."""

    DEVICE = 1
    FUNCTION = 2
    BIN = 3
    SECTION = 4
    UNIT = 5
    CONNECTOR = 6
    NAVIGATION = 7


class Trigger(IntFlag):
    """How a value may be asked for."""

    TIME = 1
    DISTANCE = 2
    THRESHOLD = 4
    CHANGE = 8
    TOTAL = 16
    ANY = 15


@dataclass(frozen=True, slots=True)
class Presentation:
    """How a raw value is shown: (raw + offset) * scale, with decimals and a unit."""

    unit: str
    scale: float
    decimals: int
    offset: int = 0


@dataclass(frozen=True, slots=True)
class Variable:
    """A process data variable: DDI, designator, how it is shown, whether it is in the default set and settable, triggers."""

    ddi: int
    designator: str
    presentation: Presentation | None = None
    triggers: Trigger = Trigger.ANY
    default: bool = True
    settable: bool = False


@dataclass(frozen=True, slots=True)
class Property:
    """A value that stays as it is."""

    ddi: int
    designator: str
    value: int
    presentation: Presentation | None = None


@dataclass(frozen=True, slots=True)
class Element:
    """A device element. Its number is its place in the device's list; parent: number of another element, None: the device."""

    kind: ElementType
    designator: str
    parent: int | None = None
    variables: tuple[Variable, ...] = ()
    properties: tuple[Property, ...] = ()


@dataclass(frozen=True, slots=True)
class Device:
    """A device and its elements, the first of which is the device itself."""

    designator: str
    software_version: str
    name: Name
    serial_number: str
    elements: tuple[Element, ...]

    def variable(self, element: int, ddi: int) -> Variable | None:
        """A process data variable by element number and DDI."""
        if not 0 <= element < len(self.elements):
            return None
        return next((v for v in self.elements[element].variables if v.ddi == ddi), None)

    def structure_label(self, version: int) -> bytes:
        """Seven characters that change whenever anything else in the pool does."""
        digest = hashlib.sha256(_Writer(self, version, bytes(LABEL_BYTES)).data).digest()
        alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ234567"
        return bytes(alphabet[byte % len(alphabet)] for byte in digest[:LABEL_BYTES])

    def pool(self, version: int) -> bytes:
        """The object pool for a task controller of ISO 11783-10 version `version`."""
        return _Writer(self, version, self.structure_label(version)).data


def _text(text: str) -> bytes:
    data = text.encode("utf-8")[:32]
    # Not in the middle of a character.
    data = data.decode("utf-8", "ignore").encode("utf-8")
    return bytes([len(data)]) + data


@dataclass(slots=True)
class _Writer:
    device: Device
    version: int
    label: bytes
    objects: list[bytes] = field(default_factory=list)
    presentations: dict[Presentation, int] = field(default_factory=dict)
    next_id: int = 1

    @property
    def data(self) -> bytes:
        device = self.device
        serial = device.serial_number.encode("ascii", "replace")[:32]
        head = struct.pack("<3sH", b"DVC", 0) + _text(device.designator) + _text(device.software_version) + device.name.data
        head += bytes([len(serial)]) + serial + self.label + LOCALIZATION
        if self.version >= _EXTENDED_LABEL_VERSION:
            head += b"\x00"
        element_ids = [self._new_id() for _ in device.elements]
        for number, element in enumerate(device.elements):
            self._element(number, element, element_ids)
        return head + b"".join(self.objects)

    def _new_id(self) -> int:
        self.next_id += 1
        return self.next_id - 1

    def _element(self, number: int, element: Element, ids: Sequence[int]) -> None:
        children = [self._variable(v) for v in element.variables] + [self._property(p) for p in element.properties]
        parent = 0 if number == 0 else ids[element.parent or 0]
        head = struct.pack("<3sHB", b"DET", ids[number], element.kind) + _text(element.designator)
        body = struct.pack("<HHH", number, parent, len(children)) + b"".join(struct.pack("<H", child) for child in children)
        self.objects.append(head + body)

    def _variable(self, variable: Variable) -> int:
        shown, own = self._presentation(variable.presentation), self._new_id()
        properties = int(variable.default) | int(variable.settable) << 1
        head = struct.pack("<3sHHBB", b"DPD", own, variable.ddi, properties, variable.triggers)
        self.objects.append(head + _text(variable.designator) + struct.pack("<H", shown))
        return own

    def _property(self, item: Property) -> int:
        shown, own = self._presentation(item.presentation), self._new_id()
        head = struct.pack("<3sHHi", b"DPT", own, item.ddi, item.value)
        self.objects.append(head + _text(item.designator) + struct.pack("<H", shown))
        return own

    def _presentation(self, presentation: Presentation | None) -> int:
        if presentation is None:
            return NO_OBJECT
        known = self.presentations.get(presentation)
        if known is not None:
            return known
        own = self.presentations[presentation] = self._new_id()
        head = struct.pack("<3sHifB", b"DVP", own, presentation.offset, presentation.scale, presentation.decimals)
        self.objects.append(head + _text(presentation.unit))
        return own
