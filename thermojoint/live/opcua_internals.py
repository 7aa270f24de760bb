"""All uses of private parts of asyncua, for features missing from its public interface.

tests/project/test_private_parts.py lists what it relies on; `pyproject.toml` bounds the version.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User
from asyncua.server import Server

from thermojoint.live.descriptors import leaves_reserve
from thermojoint.live.rights import Role

#: A silent session ends after this time, ms; the shortest publishing interval, ms.
_SESSION_MS, _FASTEST_MS = 60_000.0, 50.0
#: Values of one item that may be queued.
_QUEUE = 100
#: Largest number of connections that have not logged in: per address, and in total.
_MOST_OF_ONE, _MOST_WAITING = 8, 64
#: Interval at which the accounts of connected users are checked, s.
CHECKED_S = 3.0
#: Time to log in, s.
_LOGIN_S = 10.0
#: Requests of a session that name subscriptions by their number.
_ON_SUBSCRIPTIONS = (
    *("create_monitored_items", "modify_monitored_items", "delete_monitored_items"),
    *("modify_subscription", "delete_subscriptions", "transfer_subscriptions"),
    *("set_monitoring_mode", "set_publishing_mode", "republish"),
)


def value_of(server: Server, nodeid: ua.NodeId) -> Any:  # noqa: ANN401
    """Return the value attribute of a variable of a server, with its callback."""
    return server.iserver.aspace._nodes[nodeid].attributes[ua.AttributeIds.Value]


def limit(server: Server, sessions: int, subscriptions: int, items: int) -> None:
    """Limit the resources of a server, before it starts."""
    inner = server.iserver
    # `limit_connections` does the counting; connections that it aborts vanish a moment later.
    inner.max_connections = sessions + 4 * _MOST_WAITING
    inner.max_pending_activation_seconds = _LOGIN_S
    inner.max_session_timeout_ms = _SESSION_MS
    inner.max_subscriptions = subscriptions
    inner.max_monitored_item_queue_size = _QUEUE
    inner.max_unacked_messages_per_subscription = _QUEUE
    inner.max_pending_messages_per_connection = _QUEUE
    _cap_items(inner, items)


class Connections(list[Any]):
    """Connections of a server; clients that have not logged in cannot block those that have."""

    def __init__(self, sessions: int) -> None:
        super().__init__()
        #: Largest number of connections that have logged in.
        self.sessions = sessions

    def append(self, one: Any) -> None:  # noqa: ANN401
        """Add a connection; the oldest one that has not logged in is dropped if necessary."""
        waiting = [other for other in self if not _is_in(other)]
        same = [other for other in waiting if _host(other) == _host(one)]
        connection = one.transport.get_extra_info("socket")
        if len(self) - len(waiting) >= self.sessions or not leaves_reserve(connection.fileno()):
            one.transport.abort()
        elif len(same) >= _MOST_OF_ONE:
            same[0].transport.abort()
        elif len(waiting) >= _MOST_WAITING:
            waiting[0].transport.abort()
        super().append(one)


def _is_in(one: Any) -> bool:  # noqa: ANN401
    session = one.processor.session
    return session is not None and session.is_activated()


def _host(one: Any) -> str:  # noqa: ANN401
    return str(one.peer_name[0]) if one.peer_name else ""


def limit_connections(server: Server, sessions: int) -> None:
    """Limit the connections of a server that has just started."""
    assert server.bserver is not None
    server.bserver.clients = Connections(sessions)


def subscribers(server: Server) -> Iterator[tuple[User, Any]]:
    """Yield the subscriptions of all logged-in users, each with its user."""
    inner = server.iserver
    users = {one.session_id: one.user for one in inner._external_sessions.values()}
    for subscription in list(inner.subscription_service.subscriptions.values()):
        if subscription.session_id in users:
            yield users[subscription.session_id], subscription


async def send_event(subscription: Any, event: Any) -> None:  # noqa: ANN401
    """Send an event to the items of a subscription that monitor the emitting node."""
    await subscription.monitored_item_srv.trigger_event(event)


class Access(Protocol):
    """Interface that checks users and their rights on nodes."""

    peer: str

    def refusal(self, user: User, node: ua.NodeId, role: Role) -> str:
        """Return why a user may not read a node; empty if he may."""

    def hides(self, user: User, node: ua.NodeId) -> bool:
        """Return whether a node does not exist for a user."""


async def disconnect_ended(server: Server) -> None:
    """Disconnect users whose account has ended, who would keep their sessions; never returns."""
    assert server.bserver is not None
    while True:
        await asyncio.sleep(CHECKED_S)
        for one in list(server.bserver.clients):
            if _is_in(one) and server.iserver.user_manager.has_ended(one.processor.session.user):
                one.transport.abort()


def enforce_access(server: Server, access: Access) -> None:
    """Pass on the address of each log-in, and hide what a user may not see.

    That is nodes, and the subscriptions of other users: a number is easily guessed, and whoever
    takes one over receives its values.
    """
    inner = server.iserver
    decrypt, service = inner.decrypt_user_token, inner.subscription_service
    begin = inner.create_session

    def decrypt_of(session: Any, token: ua.UserNameIdentityToken) -> tuple[str, str]:  # noqa: ANN401
        # The name of a session is the address of its connection.
        access.peer = str(session.name[0]) if session.name else ""
        return decrypt(session, token)

    def session_of(*given: Any, **named: Any) -> Any:  # noqa: ANN401
        session = begin(*given, **named)
        browse, translate = session.browse, session.translate_browsepaths_to_nodeids
        read_history, subscribe = session.history_read, session.create_subscription

        async def subscribe_owned(*given: Any, **named: Any) -> Any:  # noqa: ANN401
            result = await subscribe(*given, **named)
            service.subscriptions[result.SubscriptionId].owner = session.user.name
            return result

        def permitted(request: Callable[..., Any], params: Any, *rest: Any) -> Any:  # noqa: ANN401
            named = filter(None, map(service.subscriptions.get, _subscriptions_in(params)))
            if any(one.owner != session.user.name for one in named) or any(
                access.refusal(session.user, item.ItemToMonitor.NodeId, "viewer")
                for item in getattr(params, "ItemsToCreate", ())
            ):
                raise ServiceError(ua.StatusCodes.BadUserAccessDenied)
            return request(params, *rest)

        async def browse_seen(params: ua.BrowseParameters) -> list[ua.BrowseResult]:
            results = await browse(params)
            for one in results:
                one.References = [
                    found
                    for found in one.References
                    if not access.hides(session.user, found.NodeId)
                ]
            return results

        async def translate_seen(params: list[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
            results = await translate(params)
            for one in results:
                if any(access.hides(session.user, found.TargetId) for found in one.Targets):
                    one.Targets, one.StatusCode = [], ua.StatusCode(ua.StatusCodes.BadNoMatch)
            return results

        async def history_seen(params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
            results = []
            for node in params.NodesToRead:
                code = ua.StatusCodes.BadUserAccessDenied
                if not access.refusal(session.user, node.NodeId, "viewer"):
                    try:
                        results += await read_history(replace(params, NodesToRead=[node]))
                        continue
                    except ua.UaStatusCodeError as error:
                        code = error.code
                results.append(ua.HistoryReadResult(StatusCode=ua.StatusCode(code)))
            return results

        session.history_read, session.create_subscription = history_seen, subscribe_owned
        session.browse, session.translate_browsepaths_to_nodeids = browse_seen, translate_seen
        for name in _ON_SUBSCRIPTIONS:
            setattr(session, name, partial(permitted, getattr(session, name)))
        return session

    inner.create_session = session_of
    inner.decrypt_user_token = decrypt_of


def _subscriptions_in(params: Any) -> Sequence[int]:  # noqa: ANN401
    """Return the numbers of the subscriptions that a request names."""
    one = getattr(params, "SubscriptionId", None)
    # A request to delete some has the numbers alone.
    return [one] if one is not None else getattr(params, "SubscriptionIds", params) or ()


def _cap_items(inner: Any, most: int) -> None:  # noqa: ANN401
    """Limit the number of monitored items and the publishing rate."""
    service = inner.subscription_service
    create, subscribe = service.create_monitored_items, service.create_subscription

    async def create_capped(params: ua.CreateMonitoredItemsParameters) -> Any:  # noqa: ANN401
        there = sum(
            len(subscription.monitored_item_srv._monitored_items)
            for subscription in service.subscriptions.values()
        )
        if there + len(params.ItemsToCreate) > most:
            raise ServiceError(ua.StatusCodes.BadTooManyMonitoredItems)
        return await create(params)

    async def subscribe_slower(
        params: ua.CreateSubscriptionParameters,
        *rest: Any,  # noqa: ANN401
        **named: Any,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        wanted = params.RequestedPublishingInterval
        # NaN also becomes the shortest interval.
        params.RequestedPublishingInterval = wanted if wanted >= _FASTEST_MS else _FASTEST_MS
        return await subscribe(params, *rest, **named)

    service.create_monitored_items = create_capped
    service.create_subscription = subscribe_slower
