"""How often somebody may ask: a bucket of tokens for each, in bounded memory."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address


@dataclass(frozen=True)
class Rate:
    """At most `burst` at once, then `per_s` a second."""

    burst: float
    per_s: float


class RateLimit:
    """One bucket for each name; of more than `names` the one that asked longest ago is forgotten."""

    def __init__(self, rate: Rate, names: int = 1024) -> None:
        self._rate = rate
        self._names = names
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, name: str, now_s: float) -> float:
        """Take one token.

        Parameters
        ----------
        name : str
            Who asks.
        now_s : float
            Monotonic time.

        Returns
        -------
        float
            0 where there was a token, else how long to wait for one, s.
        """
        wait_s = self.wait_s(name, now_s)
        level = self._level(name, now_s)
        self._buckets[name] = (level if wait_s else level - 1.0, now_s)
        self._buckets.move_to_end(name)
        if len(self._buckets) > self._names:
            self._buckets.popitem(last=False)
        return wait_s

    def wait_s(self, name: str, now_s: float) -> float:
        """How long until `take` would give a token, s; takes none."""
        return max(0.0, (1.0 - self._level(name, now_s)) / self._rate.per_s)

    def _level(self, name: str, now_s: float) -> float:
        level, then_s = self._buckets.get(name, (self._rate.burst, now_s))
        return min(self._rate.burst, level + max(0.0, now_s - then_s) * self._rate.per_s)


def peer_name(address: str) -> str:
    """Who counts as one: an IPv4 address, or the /64 network of an IPv6 one, of which a host has as many as it likes."""
    try:
        ip = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if not isinstance(ip, IPv6Address):
        return str(ip)
    return str(ip.ipv4_mapped) if ip.ipv4_mapped else str(IPv6Address(int(ip) >> 64 << 64))
