"""NAMEs of SAE J1939-81: 64 bits that distinguish every node of a network."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

_BITS = {
    "identity_number": (0, 21),
    "manufacturer_code": (21, 11),
    "ecu_instance": (32, 3),
    "function_instance": (35, 5),
    "function": (40, 8),
    "reserved": (48, 1),
    "vehicle_system": (49, 7),
    "vehicle_system_instance": (56, 4),
    "industry_group": (60, 3),
    "arbitrary_address_capable": (63, 1),
}
_NAME_BYTES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Name:
    """The fields of a NAME. Of two nodes that want one address the lower NAME, as a number, gets it.

    Parameters
    ----------
    identity_number : int
        0 to 2097151, unique among the maker's units.
    manufacturer_code : int
        0 to 2047, as SAE assigns them.
    ecu_instance, function_instance, vehicle_system_instance : int
        Which of several alike: 0 to 7, 0 to 31, 0 to 15.
    function : int
        0 to 255, J1939 appendix B11 and B12.
    vehicle_system : int
        0 to 127; ISO 11783 calls it the device class.
    industry_group : int
        0 to 7; 2 is agricultural equipment.
    arbitrary_address_capable : bool
        Whether the node can take another address when it loses the one that it prefers.
    reserved : int
        0; kept as it comes, since it counts in a contention.

    References
    ----------
    SAE J1939-81, 4.1.1; ISO 11783-5, 4.3.
    """

    identity_number: int
    manufacturer_code: int = 0
    ecu_instance: int = 0
    function_instance: int = 0
    function: int = 0
    vehicle_system: int = 0
    vehicle_system_instance: int = 0
    industry_group: int = 0
    arbitrary_address_capable: bool = True
    reserved: int = 0

    def __post_init__(self) -> None:
        for key, (_start, width) in _BITS.items():
            value = getattr(self, key)
            if not 0 <= value < 1 << width:
                raise ValueError(f"NAME: {key} is {value}, expected 0 to {(1 << width) - 1}")

    @classmethod
    def of_int(cls, value: int) -> Name:
        """The NAME that a 64-bit number spells."""
        fields = {key: value >> start & ((1 << width) - 1) for key, (start, width) in _BITS.items()}
        return cls(**{**fields, "arbitrary_address_capable": bool(fields["arbitrary_address_capable"])})  # type: ignore[arg-type]

    @classmethod
    def of_bytes(cls, data: bytes) -> Name:
        """The NAME in the eight bytes of an address claim. Raises ValueError for another length."""
        if len(data) != _NAME_BYTES:
            raise ValueError(f"NAME of {len(data)} bytes, expected {_NAME_BYTES}")
        return cls.of_int(int.from_bytes(data, "little"))

    def __int__(self) -> int:
        value = 0
        for key, (start, _width) in _BITS.items():
            value |= int(getattr(self, key)) << start
        return value

    @property
    def data(self) -> bytes:
        """The eight bytes of an address claim."""
        return int(self).to_bytes(_NAME_BYTES, "little")

    def __str__(self) -> str:
        return f"{int(self):016X}"


@dataclass(frozen=True, slots=True, kw_only=True)
class NameMatch:
    """Which NAMEs a partner may have: every field that is not None must be equal."""

    identity_number: int | None = None
    manufacturer_code: int | None = None
    ecu_instance: int | None = None
    function_instance: int | None = None
    function: int | None = None
    vehicle_system: int | None = None
    vehicle_system_instance: int | None = None
    industry_group: int | None = None

    def matches(self, name: Name) -> bool:
        """Whether a NAME is one of these."""
        wanted = ((field.name, getattr(self, field.name)) for field in dataclasses.fields(self))
        return all(value is None or getattr(name, key) == value for key, value in wanted)
