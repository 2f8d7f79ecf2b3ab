"""Which NAME holds which address, as the claims on the bus say."""

from __future__ import annotations

from yieldmon.identifiers import NULL_ADDRESS

from .identifier import ADDRESS_CLAIMED, FIRST_UNUSABLE_ADDRESS, Identifier
from .name import Name, NameMatch


class AddressTable:
    """Addresses and their holders; at most one NAME an address and one address a NAME, so at most 254 entries.

    The last claim counts: whoever wins a contention claims once more.
    """

    def __init__(self) -> None:
        self._names: dict[int, Name] = {}
        self._addresses: dict[int, int] = {}

    def receive(self, identifier: int, data: bytes) -> Name | None:
        """Takes in a frame; the claiming NAME where it is an address claim, else None."""
        parts = Identifier.of(identifier)
        if parts.group != ADDRESS_CLAIMED or len(data) != 8:
            return None
        name = Name.of_bytes(data)
        self.claimed(parts.source, name)
        return name

    def claimed(self, address: int, name: Name) -> None:
        """A NAME has claimed an address, or said that it has none (254)."""
        number = int(name)
        if address >= FIRST_UNUSABLE_ADDRESS:
            if address == NULL_ADDRESS:
                self._forget(number)
            return
        holder = self._names.get(address)
        self._forget(number)
        if holder is not None and int(holder) != number:
            self._forget(int(holder))
        self._names[address] = name
        self._addresses[number] = address

    def _forget(self, number: int) -> None:
        address = self._addresses.pop(number, None)
        if address is not None:
            del self._names[address]

    def clear(self) -> None:
        """Forget all: everybody is about to be asked."""
        self._names.clear()
        self._addresses.clear()

    def name_of(self, address: int) -> Name | None:
        """Holder of an address, None while it has not claimed."""
        return self._names.get(address)

    def address_of(self, wanted: Name | NameMatch) -> int | None:
        """Address of a NAME; of a NameMatch, that of the only NAME that it fits. None while there is none, or more than one."""
        if isinstance(wanted, Name):
            return self._addresses.get(int(wanted))
        found = [address for address, name in self._names.items() if wanted.matches(name)]
        return found[0] if len(found) == 1 else None

    def items(self) -> list[tuple[int, Name]]:
        """(address, NAME) in the order of the addresses."""
        return sorted(self._names.items(), key=lambda item: item[0])
