"""Access control of the OPC UA server: encryption, users, limits.

asyncua's own defaults offer unencrypted channels, and take ``admin`` without a password for an
administrator. None of that is left here: nobody is an administrator, and nobody is let in whom the
file of users does not know.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.permission_rules import USER_TYPES, SimpleRoleRuleset, User, UserRole
from asyncua.server import Server
from asyncua.server.user_managers import UserManager

from thermojoint.live.log_lines import EventLog
from thermojoint.live.opcua_internals import limit
from thermojoint.live.users import Gate, Role

#: No request is larger, bytes.
_LARGEST = 1 << 20

_WRITES = {ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary)}
_NEVER = {ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary)}


@dataclass
class Known(User):
    """A user who has logged in.

    Attributes
    ----------
    may : str
        ``reads`` or ``writes``.
    """

    may: Role = "reads"


class Rules(SimpleRoleRuleset):
    """Reading users read, browse and subscribe; writing users also write; nobody does more."""

    def __init__(self) -> None:
        super().__init__()
        self._reads = set(map(ua.NodeId, USER_TYPES)) - _WRITES - _NEVER

    def check_validity(self, user: User | None, action_type_id: ua.NodeId, body: Any) -> bool:  # noqa: ANN401
        """Say whether a user may ask for something."""
        if not isinstance(user, Known):
            return False
        allowed = action_type_id in self._reads
        return allowed or (user.may == "writes" and action_type_id in _WRITES)


@dataclass(eq=False)
class Door(UserManager):
    """Asks for name and password, and for a certificate that is trusted.

    Attributes
    ----------
    gate : Gate or None
        None: whoever comes may read.
    trusted : frozenset of bytes or None
        Certificates (DER) of clients; None: any, as the password decides.
    log : EventLog
        Told of everybody who is not let in.
    """

    gate: Gate | None
    trusted: frozenset[bytes] | None
    log: EventLog

    def get_user(
        self,
        iserver: Any,  # noqa: ANN401
        username: str | None = None,
        password: str | bytes | None = None,
        certificate: Any = None,  # noqa: ANN401
    ) -> User | None:
        """Return who it is; None sends him away. The certificate is that of the channel."""
        if self.trusted is not None and certificate not in self.trusted:
            self.log.say(time.time(), "refused", "OPC UA: the client's certificate is not trusted")
            return None
        if self.gate is None:
            return Known(role=UserRole.User, name="anybody")
        if not isinstance(username, str) or password is None:
            return None
        if isinstance(password, bytes):
            password = password.decode("utf-8", "replace")
        role = self.gate.role_of(username, password, time.monotonic())
        if role is None:
            shown = username[:40]
            self.log.say(time.time(), "refused", f"OPC UA: user {shown!r}: not let in")
            return None
        return Known(role=UserRole.User, name=username, may=role)


def restrict(
    server: Server, encrypted: bool, door: Door, sessions: int, subscriptions: int, items: int
) -> None:
    """Give a server its limits, before it starts.

    Parameters
    ----------
    server : Server
    encrypted : bool
        Basic256Sha256, signed and encrypted, and nothing else; or no security at all.
    door : Door
        Whom it lets in.
    sessions, subscriptions, items : int
        How many there may be at once.
    """
    policy = (
        ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
        if encrypted
        else ua.SecurityPolicyType.NoSecurity
    )
    server.set_security_policy([policy], permission_ruleset=Rules())
    token = ua.AnonymousIdentityToken if door.gate is None else ua.UserNameIdentityToken
    server.set_identity_tokens([token])
    server.allow_remote_admin(False)
    server.limits = TransportLimits(
        max_recv_buffer=65535,
        max_send_buffer=65535,
        max_chunk_count=_LARGEST // 65535 + 1,
        max_message_size=_LARGEST,
    )
    limit(server, sessions, subscriptions, items)
