"""An alarm of the OPC UA server for each machine whose displacement is bad (Part 9).

An OffNormalAlarmType without acknowledgement: it is active as long as the value is bad. It is sent
to clients that monitor the events of the machine or of the Server object and may see the machine.
"""

from __future__ import annotations

import copy
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua, uamethod
from asyncua.server import Server

from estimator.quality import Quality
from thermojoint.live.opcua_access import AccessControl
from thermojoint.live.opcua_internals import send_event, subscribers
from thermojoint.live.opcua_values import status_of
from thermojoint.live.publication import Publication
from thermojoint.live.publisher import Publisher

#: Severity of an alarm, 1 to 1000 (Part 5: 667 to 1000 is high).
SEVERITY = 700
_SERVER = ua.NodeId(ua.ObjectIds.Server)
_NAME = "ThermalDisplacementBad"


@dataclass(frozen=True, eq=False)
class Alarms:
    """Alarms of a server."""

    server: Server
    access: AccessControl
    #: Index of the service's namespace.
    index: int
    #: Prototype with all fields of the type.
    template: Any
    #: Active alarms by machine.
    active: dict[str, Any]
    #: Nodes where all events can be monitored: the Server object, the Machines folder.
    above: tuple[ua.NodeId, ...]


async def add_alarms(
    server: Server, access: AccessControl, index: int, folders: tuple[ua.NodeId, ...]
) -> Alarms:
    """Enable the machines of a server to emit events, and its clients to request active ones."""
    generator = await server.get_event_generator(ua.ObjectIds.OffNormalAlarmType)
    for machine in access.machines:
        node = server.get_node(ua.NodeId(machine, index))
        await node.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
    alarms = Alarms(server, access, index, generator.event, {}, (_SERVER, *folders))
    bounds = [
        await server.get_event_generator(kind)
        for kind in (ua.ObjectIds.RefreshStartEventType, ua.ObjectIds.RefreshEndEventType)
    ]

    @uamethod  # type: ignore[untyped-decorator,unused-ignore]
    async def refresh(parent: Any, subscription: int, item: int | None = None) -> Any:  # noqa: ANN401
        """Send the active alarms to all items of one subscription."""
        known = {one.data.SubscriptionId for _, one in subscribers(server)}
        if subscription not in known:
            return ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        await bounds[0].trigger(subscription_id=subscription)
        for event in list(alarms.active.values()):
            await _send_event(alarms, event, subscription)
        await bounds[1].trigger(subscription_id=subscription)
        return None

    for method in ("ConditionType_ConditionRefresh", "ConditionType_ConditionRefresh2"):
        server.link_method(server.get_node(ua.NodeId(getattr(ua.ObjectIds, method))), refresh)
    return alarms


async def send_alarms(alarms: Alarms, publisher: Publisher) -> None:
    """Send an alarm when a value becomes bad, changes its reason, or recovers; until cancelled."""
    sent_status: dict[str, str] = {}
    with publisher.subscribe() as subscription:
        while True:
            for machine in await subscription.wait():
                latest = publisher.newest[machine]
                status = latest.status if latest.quality is Quality.BAD else ""
                if status == sent_status.get(machine, ""):
                    continue
                sent_status[machine] = status
                event = alarm_of(alarms, latest, bool(status))
                if status:
                    alarms.active[machine] = event
                else:
                    alarms.active.pop(machine, None)
                await _send_event(alarms, event)


async def _send_event(alarms: Alarms, event: Any, only: int | None = None) -> None:  # noqa: ANN401
    for user, subscription in subscribers(alarms.server):
        wanted = only is None or subscription.data.SubscriptionId == only
        if wanted and not alarms.access.hides(user, event.SourceNode):
            for emitter in (event.SourceNode, *alarms.above):
                event.emitting_node = emitter
                await send_event(subscription, event)


def alarm_of(alarms: Alarms, latest: Publication, active: bool) -> Any:  # noqa: ANN401
    """Return the present alarm of a machine."""
    machine, index, now = latest.machine, alarms.index, datetime.now(UTC)
    event = copy.copy(alarms.template)
    states = {
        "EnabledState": ("Enabled", True),
        "AckedState": ("Acknowledged", True),
        "ActiveState": ("Active" if active else "Inactive", active),
    }
    values = {
        "EventId": uuid.uuid4().bytes,
        "Time": now,
        "ReceiveTime": now,
        "SourceNode": ua.NodeId(machine, index),
        "SourceName": machine,
        "Message": ua.LocalizedText(
            f"the displacement of {machine} is {latest.quality.word}: {latest.status}"
        ),
        "Severity": SEVERITY,
        "LastSeverity": SEVERITY,
        # The condition, which is not a node.
        "NodeId": ua.NodeId(f"{machine}.{_NAME}", index),
        "ConditionName": _NAME,
        "ConditionClassId": ua.NodeId(ua.ObjectIds.ProcessConditionClassType),
        "ConditionClassName": ua.LocalizedText("ProcessConditionClassType"),
        "BranchId": ua.NodeId(),
        "Retain": active,
        "Quality": ua.StatusCode(status_of(latest)),
        "Comment": ua.LocalizedText(""),
        "ClientUserId": "",
        "InputNode": ua.NodeId(f"{machine}.ThermalDisplacement", index),
        "NormalState": ua.NodeId(),
        "SuppressedOrShelved": False,
    }
    for name, (text, value) in states.items():
        values |= {name: ua.LocalizedText(text), f"{name}/Id": value}
    for name, value in values.items():
        setattr(event, name, value)
    return event
