"""Alarms of the OPC UA server: a client hears of a value that becomes bad, and that it is over."""

import asyncio
import contextlib
import time

import pytest
from asyncua import ua
from dashboard_server import ABOUT, publication
from live_parts import client_of, free_port, until

from estimator.quality import Quality
from thermojoint.live.access_store import open_access
from thermojoint.live.accounts import Accounts
from thermojoint.live.audit import Audit
from thermojoint.live.hub import Hub
from thermojoint.live.log_lines import EventLog
from thermojoint.live.settings import OpcuaServer
from thermojoint.live.users import add_user
from thermojoint.live.writers.opcua import Entry, open_server, serve_nodes

MACHINES = ("mill-1", "lathe-1")
KINDS = [
    ua.ObjectIds.OffNormalAlarmType,
    ua.ObjectIds.RefreshStartEventType,
    ua.ObjectIds.RefreshEndEventType,
]


class Heard:
    """Callbacks of a subscription."""

    def __init__(self):
        self.events = []

    def event_notification(self, event):
        self.events.append(event)

    def alarms(self):
        return [
            (
                one.SourceName,
                getattr(one, "ActiveState/Id"),
                one.Retain,
                one.Severity,
                one.Message.Text,
            )
            for one in self.events
            if one.SourceName in MACHINES
        ]


@contextlib.asynccontextmanager
async def plant(base):
    """A server with two machines and two users, of whom one sees the mill only."""
    folder = base / "state"
    folder.mkdir()
    add_user(folder / "users", "plant", "viewer", "plants-secret")
    add_user(folder / "users", "mill", "viewer", "mills-secret", ["mill-*"])
    hub, port = Hub(), free_port()
    hub.publish([publication(1, time.time(), name) for name in MACHINES])
    accounts = Accounts(open_access(folder), Audit(folder / "audit.jsonl"), folder / "users")
    server, nodes = await open_server(
        OpcuaServer(port=port, users=folder / "users"),
        Entry(accounts, folder, EventLog(), {}),
        hub,
        dict.fromkeys(MACHINES, (ABOUT.layout, 1)),
        [].append,
        {},
    )
    serving = asyncio.create_task(serve_nodes(server, nodes, hub))
    try:
        yield hub, port
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        accounts.store.close()


async def hears(client, where=ua.ObjectIds.Server):
    heard = Heard()
    subscription = await client.create_subscription(50.0, heard)
    await subscription.subscribe_alarms_and_conditions(where, KINDS)
    return heard, subscription


def bad(number, machine, status="silent"):
    return publication(
        number, time.time(), machine, quality=Quality.BAD, status=status, published=time.time()
    )


def test_a_value_that_becomes_bad_is_an_alarm_to_all_who_see_the_machine(tmp_path):
    async def live():
        async with (
            plant(tmp_path) as (hub, port),
            await client_of(tmp_path, port, "plant", "plants-secret") as of_plant,
            await client_of(tmp_path, port, "mill", "mills-secret") as of_mill,
        ):
            everything, _ = await hears(of_plant)
            of_machine, _ = await hears(of_plant, "ns=2;s=mill-1")
            mills, _ = await hears(of_mill)
            hub.publish([bad(2, "lathe-1"), bad(2, "mill-1")])
            await until(lambda: len(everything.alarms()) == 2)
            hub.publish([publication(3, time.time(), "mill-1")])
            await until(lambda: len(everything.alarms()) == 3)
            await until(lambda: len(of_machine.alarms()) == len(mills.alarms()) == 2)
            # A client that comes later asks for what is active.
            late, subscription = await hears(of_plant)
            kind = of_plant.get_node(ua.NodeId(ua.ObjectIds.ConditionType))
            number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
            await kind.call_method("0:ConditionRefresh", number)
            await until(lambda: len(late.events) == 3)
            # It is all that anybody may call.
            server = of_plant.nodes.server
            with pytest.raises(ua.UaError):
                await server.call_method("0:GetMonitoredItems", number)
            return everything, of_machine, mills, late

    everything, of_machine, mills, late = asyncio.run(live())
    silent = "the displacement of mill-1 is bad: silent"
    begun = ("mill-1", True, True, 700, silent)
    assert set(everything.alarms()[:2]) == {
        begun,
        ("lathe-1", True, True, 700, "the displacement of lathe-1 is bad: silent"),
    }
    for one in (of_machine, mills):
        assert one.alarms()[0] == begun
        assert one.alarms()[1][:3] == ("mill-1", False, False)
    assert [one.SourceName for one in late.events] == ["Server", "lathe-1", "Server"]
    first = mills.events[0]
    assert first.EventType == ua.NodeId(ua.ObjectIds.OffNormalAlarmType)
    assert first.NodeId == ua.NodeId("mill-1.ThermalDisplacementBad", 2)
    assert first.Quality.name == "BadNoCommunication"
