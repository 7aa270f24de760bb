"""Rate limits per client by token buckets."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict
from dataclasses import dataclass, field

#: Number of remembered clients; the one that was silent longest is forgotten first.
MOST_CLIENTS = 4096


@dataclass
class RateLimit:
    """Rate limit by token buckets, one per client, full at first."""

    #: Tokens per second.
    rate: float
    #: Largest number of tokens.
    size: float
    #: Client to its level and the time of this level, s.
    levels: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict)

    def wait(self, client: str, now: float) -> float:
        """Return the time for which a client must wait for a token, s; 0 if there is one."""
        return max(0.0, (1.0 - self._level(client, now)) / self.rate)

    def take(self, client: str, now: float) -> float:
        """Take a token if there is one; return the result of `wait` before that."""
        waiting = self.wait(client, now)
        if waiting > 0.0:
            return waiting
        self.levels[client] = (self._level(client, now) - 1.0, now)
        self.levels.move_to_end(client)
        while len(self.levels) > MOST_CLIENTS:
            self.levels.popitem(last=False)
        return 0.0

    def _level(self, client: str, now: float) -> float:
        level, since = self.levels.get(client, (self.size, now))
        return min(self.size, level + self.rate * max(0.0, now - since))


def client_of(address: str) -> str:
    """Return the client of an address: the IPv4 address, or the /64 network of an IPv6 one."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(parsed, ipaddress.IPv6Address):
        return str(ipaddress.ip_network((int(parsed) >> 64 << 64, 64)))
    return str(parsed)
