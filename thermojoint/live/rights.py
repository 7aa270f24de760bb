"""Roles, and the rights of a user or token on each machine."""

from __future__ import annotations

from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Literal

Role = Literal["viewer", "operator", "engineer"]
#: Roles: to read; also to write readings; also to change models.
ROLES: tuple[Role, ...] = ("viewer", "operator", "engineer")
#: Rights on every machine.
ALL_MACHINES = ("*",)


@dataclass(frozen=True)
class Principal:
    """An authenticated user or token."""

    #: Name of the user or the token, for the audit log.
    name: str
    #: One of `ROLES`.
    role: Role = "viewer"
    #: Names or patterns (``mill-*``) of the machines for which the role holds; others are hidden.
    machines: tuple[str, ...] = ALL_MACHINES
    #: Digest of the password's hash or of the token: sessions are valid as long as it is in use.
    credential: str = field(default="", repr=False)

    @property
    def sees_all(self) -> bool:
        """Whether every machine is visible."""
        return "*" in self.machines

    def sees(self, machine: str) -> bool:
        """Whether a machine is visible."""
        return any(fnmatchcase(machine, pattern) for pattern in self.machines)

    def refusal(self, role: Role, machine: str) -> str:
        """Return why this principal may not act in a role on a machine; empty if it may."""
        if not self.sees(machine):
            return f"no right on {machine}"
        if ROLES.index(self.role) < ROLES.index(role):
            return f"needs the role {role}, has {self.role}"
        return ""
