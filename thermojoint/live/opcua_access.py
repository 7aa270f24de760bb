"""Access control of the OPC UA server: encryption, users, limits.

By default asyncua offers unencrypted channels, and accepts ``admin`` without a password as an
administrator. Here nobody is an administrator, and only users of the users' file may log in.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import USER_TYPES, SimpleRoleRuleset, User, UserRole
from asyncua.server import Server
from asyncua.server.user_managers import UserManager
from asyncua.ua.ua_binary import struct_from_binary

from thermojoint.live.accounts import Accounts
from thermojoint.live.log_lines import EventLog
from thermojoint.live.opcua_internals import enforce_access, limit
from thermojoint.live.rights import Principal, Role
from thermojoint.live.settings import OpcuaServer
from thermojoint.live.trust_list import TrustList

#: Largest request, bytes.
_LARGEST = 1 << 20

_CALL = ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary)
#: Methods that everybody may call: they send the active alarms to a subscription.
_CALLED = {
    ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh),
    ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh2),
}
_DENIED = ua.StatusCodes.BadUserAccessDenied
#: The user of a server without log-in, which only this computer reaches.
_ANYBODY = Principal("anybody")


@dataclass
class OpcuaUser(User):
    """A user who has logged in."""

    #: Rights at that time.
    principal: Principal = _ANYBODY
    #: Address, in the form of the audit log.
    origin: str = "opcua"


class RequestRules(SimpleRoleRuleset):
    """Logged-in users may read, browse, subscribe and write; nobody may add nodes.

    The only method that may be called is the refresh of alarms.
    """

    def __init__(self) -> None:
        super().__init__()
        self._allowed = set(map(ua.NodeId, USER_TYPES)) - {_CALL}

    def check_validity(self, user: User | None, action_type_id: ua.NodeId, body: Any) -> bool:  # noqa: ANN401
        """Return whether a user may make a request; `AccessControl` then checks the nodes."""
        if action_type_id == _CALL and isinstance(user, OpcuaUser):
            called = struct_from_binary(ua.CallParameters, body.copy()).MethodsToCall
            return all(one.MethodId in _CALLED for one in called)
        return isinstance(user, OpcuaUser) and action_type_id in self._allowed


@dataclass(eq=False)
class AccessControl(UserManager):
    """Checks user, password and client certificate at a log-in, and rights on machines."""

    accounts: Accounts
    #: False: anybody may read.
    requires_login: bool
    trust: TrustList
    log: EventLog
    #: Machine to the only user who may write its control's side of the handshake.
    controls: Mapping[str, str]
    machines: Collection[str]
    #: Address of the client that is logging in.
    peer: str = ""

    def get_user(
        self,
        iserver: Any,  # noqa: ANN401
        username: str | None = None,
        password: str | bytes | None = None,
        certificate: Any = None,  # noqa: ANN401
    ) -> User | None:
        """Return the user; None refuses the log-in. `certificate` belongs to the channel."""
        origin, shown = f"opcua {self.peer}".strip(), str(username or "")[:40]
        why = self.trust.refusal(certificate, datetime.now(UTC))
        principal = _ANYBODY
        if not why and self.requires_login:
            if isinstance(password, bytes):
                password = password.decode("utf-8", "replace")
            found = self.accounts.by_password(username or "", password or "")
            why = "" if found else "wrong name or password, or too many wrong ones"
            principal = found or principal
        if not why:
            try:
                self.accounts.audit.accepted(principal.name, origin, "login")
            except OSError as error:
                why = f"the audit log cannot be written ({error})"
        if why:
            self.accounts.audit.refused(shown, origin, "login", why)
            self.log.say(time.time(), "refused", f"OPC UA: user {shown!r} at {self.peer}: {why}")
            return None
        return OpcuaUser(
            role=UserRole.User, name=principal.name, principal=principal, origin=origin
        )

    def refusal(self, user: User, node: ua.NodeId, role: Role) -> str:
        """Return why a user may not read or write a node now; empty if it is allowed."""
        machine = self.machine_of(node)
        if not isinstance(user, OpcuaUser) or machine is None:
            return ""
        principal: Principal | None = user.principal
        if user.principal.credential:
            principal = self.accounts.by_credential(user.principal.credential)
        # The control's side of the handshake: NAME.Control.name.
        owner = self.controls.get(machine, user.name)
        if role == "operator" and f"{machine}.Control." in node.Identifier and owner != user.name:
            return f"only {owner} writes for the control"
        return "the user was removed" if principal is None else principal.refusal(role, machine)

    def hides(self, user: User, node: ua.NodeId) -> bool:
        """Return whether a node belongs to a machine that does not exist for a user."""
        machine = self.machine_of(node)
        return (
            machine is not None and isinstance(user, OpcuaUser) and not user.principal.sees(machine)
        )

    def machine_of(self, node: ua.NodeId) -> str | None:
        """Return the machine of a node (``NAME`` or ``NAME.Folder.name``); None for other nodes."""
        text = node.Identifier
        name = text.partition(".")[0] if isinstance(text, str) else ""
        return name if name in self.machines else None

    def has_ended(self, user: User) -> bool:
        """Return whether a user was removed, or the password changed, since the log-in."""
        credential = user.principal.credential if isinstance(user, OpcuaUser) else ""
        return bool(credential) and self.accounts.by_credential(credential) is None

    def before_write(self, event: ServerItemCallback, service: object) -> None:
        """Refuse a request to write a node without the right to do so.

        Raises
        ------
        ServiceError
            BadUserAccessDenied.
        """
        if not event.is_external:
            return
        for one in event.request_params.NodesToWrite:
            why = self.refusal(event.user, one.NodeId, "operator")
            if not why and not isinstance(event.user, OpcuaUser):
                why = "not logged in"
            if not why and self.machine_of(one.NodeId) is None:
                why = "it is of no machine"
            if why:
                self._audit(event.user, one.NodeId, why)
                raise ServiceError(_DENIED)

    def after_write(self, event: ServerItemCallback, service: object) -> None:
        """Audit the result of each written value, which may be of a missing node."""
        if not event.is_external:
            return
        asked = event.request_params.NodesToWrite
        for one, status in zip(asked, event.response_params, strict=True):
            self._audit(event.user, one.NodeId, "" if status.is_good() else status.name)

    def after_read(self, event: ServerItemCallback, service: object) -> None:
        """Replace the values of machines that the user may not see."""
        if not isinstance(event.user, OpcuaUser) or event.user.principal.sees_all:
            return
        for k, one in enumerate(event.request_params.NodesToRead):
            if self.refusal(event.user, one.NodeId, "viewer"):
                event.response_params[k] = ua.DataValue(StatusCode=ua.StatusCode(_DENIED))

    def _audit(self, user: User, node: ua.NodeId, why: str) -> None:
        """Write one line of the audit log."""
        who, origin = str(user.name), getattr(user, "origin", "opcua")
        what, machine = f"write {node.Identifier}", self.machine_of(node)
        if why:
            self.accounts.audit.refused(who, origin, what, why, machine)
        else:
            self.accounts.audit.written(who, origin, what, machine)


def restrict(server: Server, access: AccessControl, section: OpcuaServer) -> None:
    """Set security (Basic256Sha256, or none at all) and limits of a server, before it starts."""
    policy = ua.SecurityPolicyType.NoSecurity
    if section.security == "sign-and-encrypt":
        policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
    server.set_security_policy([policy], permission_ruleset=RequestRules())
    token = ua.UserNameIdentityToken if access.requires_login else ua.AnonymousIdentityToken
    server.set_identity_tokens([token])
    server.subscribe_server_callback(CallbackType.PreWrite, access.before_write)
    server.subscribe_server_callback(CallbackType.PostWrite, access.after_write)
    server.subscribe_server_callback(CallbackType.PostRead, access.after_read)
    server.allow_remote_admin(False)
    server.limits = TransportLimits(
        max_recv_buffer=65535,
        max_send_buffer=65535,
        max_chunk_count=_LARGEST // 65535 + 1,
        max_message_size=_LARGEST,
    )
    limit(server, section.most_sessions, section.most_subscriptions, section.most_items)
    enforce_access(server, access)
