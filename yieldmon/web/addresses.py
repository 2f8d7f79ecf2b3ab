"""Where the page listens, and which Host and Origin headers it answers to.

A page of somebody else's can have its own name resolve to this machine (DNS rebinding), so that the browser takes the two for one
site. Such a request carries that name in its Host header: only IP addresses and this machine's own name are answered.
"""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import urlsplit

from yieldmon.errors import InputError

DEFAULT_LISTEN = "127.0.0.1:8090"
_FORM = f"ADDRESS:PORT such as {DEFAULT_LISTEN} or 192.168.1.5:8090"
_LOOPBACK_NAME = "localhost"


@dataclass(frozen=True)
class Listen:
    """An address and port to listen at; port 0: any that is free."""

    address: IPv4Address | IPv6Address
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this machine can connect."""
        return self.address.is_loopback

    @property
    def url(self) -> str:
        """What to type into a browser on this machine, or the address itself where it is one."""
        host = ("127.0.0.1" if self.address.version == 4 else "::1") if self.address.is_unspecified else str(self.address)
        return f"http://[{host}]:{self.port}/" if ":" in host else f"http://{host}:{self.port}/"


def parse_listen(text: str) -> Listen:
    """ADDRESS:PORT; IPv6 in brackets.

    Parameters
    ----------
    text : str
        Such as ``127.0.0.1:8090``, ``[::1]:8090``, ``0.0.0.0:8090`` or ``localhost:8090``.

    Returns
    -------
    Listen
        Where to listen.

    Raises
    ------
    InputError
        For a name other than localhost, or a port that is none.
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") if host.startswith("[") else host
    try:
        address = ip_address("127.0.0.1" if host == _LOOPBACK_NAME else host)
        number = int(port) if port.isascii() and port.isdecimal() else -1
    except ValueError:
        number = -1
    if not colon or not 0 <= number <= 65535:
        raise InputError("--listen", f"is {text!r}", _FORM)
    return Listen(address, number)


def host_of(header: str) -> str | None:
    """The host in a Host header without its port, in lower case; None where it is no host."""
    try:
        parts = urlsplit(f"//{header}")
        _ = parts.port
    except ValueError:
        return None
    if parts.username is not None or parts.path or parts.query or parts.fragment:
        return None
    return parts.hostname


def host_is_ours(header: str, listen: Listen, names: frozenset[str]) -> bool:
    """Whether a request with this Host header was meant for this page.

    Parameters
    ----------
    header : str
        The header as it came.
    listen : Listen
        Where the page listens.
    names : frozenset of str
        Names of this machine, in lower case; of no use where only this machine can connect.
    """
    host = host_of(header)
    if host is None:
        return False
    if host == _LOOPBACK_NAME:
        return True
    try:
        address = ip_address(host)
    except ValueError:
        return not listen.loopback and host in names
    return address.is_loopback or listen.address.is_unspecified or address == listen.address


def origin_is_ours(origin: str, host: str) -> bool:
    """Whether an Origin header names the site that the Host header of the same request names."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower() != ""
