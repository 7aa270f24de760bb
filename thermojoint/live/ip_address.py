"""IP addresses of both versions: the family of their sockets, and their form in a URL."""

from __future__ import annotations

import socket


def family_of(address: str) -> socket.AddressFamily:
    """Return the family of the sockets of an address or host name."""
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def in_url(host: str) -> str:
    """Return a host as it stands in a URL: an IPv6 address in brackets."""
    return f"[{host}]" if family_of(host) == socket.AF_INET6 else host
