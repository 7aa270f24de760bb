"""Clients of the OPC UA server hear alarms and read the history of the service's values."""

import asyncio
import contextlib
import time
from datetime import UTC, datetime

import numpy as np
import pytest
from asyncua import ua
from dashboard_server import ABOUT, keep, publication
from live_parts import client_of, free_port, until

from estimator.quality import Quality
from thermojoint.live.access_store import open_access
from thermojoint.live.accounts import Accounts
from thermojoint.live.archive import Archive
from thermojoint.live.audit import Audit
from thermojoint.live.log_lines import EventLog
from thermojoint.live.opcua_values import variables_of
from thermojoint.live.publisher import Publisher
from thermojoint.live.settings import OpcuaServer
from thermojoint.live.users import add_user
from thermojoint.live.writers.opcua import ServerContext, fresh_server, open_server, serve_nodes
from thermojoint.live.writers.opcua_history import _MOST, ArchiveHistory

AT = 1_772_431_200.0
#: More than one response has.
COUNT = 5_200
MACHINES = ("mill-1", "lathe-1")
KINDS = [
    ua.ObjectIds.OffNormalAlarmType,
    ua.ObjectIds.RefreshStartEventType,
    ua.ObjectIds.RefreshEndEventType,
]


def bad(number, machine):
    now = time.time()
    return publication(number, now, machine, quality=Quality.BAD, status="silent")


def day(machine):
    """Samples of some hours, of which one is bad."""
    good = [publication(k + 1, AT + k, machine) for k in range(COUNT)]
    return [*good, bad(COUNT + 1, machine)]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A history of samples that are at no whole microsecond, and how to read it by pages."""
    instants = np.floor((AT + 0.7 * np.arange(2 * _MOST)) / 0.7) * 0.7
    run = [publication(k + 1, one) for k, one in enumerate(instants.tolist())]
    archive = keep(tmp_path_factory.mktemp("pages") / "store.db", [run])
    node = ua.NodeId("mill-1.SampleNumber", 2)
    (variable,) = [one for one in variables_of(ABOUT.layout, True, 2) if one.name == "SampleNumber"]
    history = ArchiveHistory(archive, {node: ("mill-1", variable)})

    def read(start, end, most=0):
        numbers = []
        while True:
            values, start = asyncio.run(history.read_node_history(node, start, end, most))
            numbers += [one.Value.Value for one in values]
            if start is None:
                return numbers

    return read


@pytest.mark.parametrize("first", range(0, 40, 8))
def test_no_value_is_lost_between_two_pages_of_a_history(pages, first):
    begun = datetime.fromtimestamp(AT + 0.7 * first, UTC)
    ended = datetime.fromtimestamp(AT + 1e4, UTC)
    forwards, backwards = pages(begun, ended), pages(ended, begun)
    assert len(forwards) > _MOST
    assert np.diff(forwards).tolist() == [1] * (len(forwards) - 1)
    assert backwards == forwards[::-1]


def test_the_newest_values_come_once_however_many_are_asked_for(pages):
    assert pages(None, None, _MOST + 3) == list(range(2 * _MOST, _MOST - 3, -1))


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
    keep(folder / "history.sqlite", [day(name) for name in MACHINES])
    publisher, port = Publisher(), free_port()
    publisher.publish([publication(1, time.time(), name) for name in MACHINES])
    accounts = Accounts(open_access(folder), Audit(folder / "audit.jsonl"), folder / "users")
    server, nodes = await open_server(
        OpcuaServer(port=port, users=folder / "users"),
        ServerContext(accounts, folder, EventLog(), {}, Archive(folder / "history.sqlite")),
        publisher,
        dict.fromkeys(MACHINES, (ABOUT.layout, 1)),
        [].append,
        {},
    )
    serving = asyncio.create_task(serve_nodes(server, nodes, publisher))
    try:
        yield publisher, port
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        accounts.store.close()


async def hears(client, where=ua.ObjectIds.Server):
    heard = Heard()
    subscription = await client.create_subscription(50.0, heard)
    await subscription.subscribe_alarms_and_conditions(where, KINDS)
    return heard, subscription


@pytest.mark.parametrize("address", ["127.0.0.1", "::1"])
def test_a_server_listens_at_either_kind_of_address(address):
    endpoint = fresh_server(OpcuaServer(address=address, port=4841)).endpoint
    assert (endpoint.hostname, endpoint.port) == (address, 4841)


def test_a_value_that_becomes_bad_is_an_alarm_to_all_who_see_the_machine(tmp_path):
    async def live():
        async with (
            plant(tmp_path) as (publisher, port),
            await client_of(tmp_path, port, "plant", "plants-secret") as of_plant,
            await client_of(tmp_path, port, "mill", "mills-secret") as of_mill,
        ):
            everything, _ = await hears(of_plant)
            of_machine, _ = await hears(of_plant, "ns=2;s=mill-1")
            mills, _ = await hears(of_mill)
            publisher.publish([bad(2, "lathe-1"), bad(2, "mill-1")])
            await until(lambda: len(everything.alarms()) == 2)
            publisher.publish([publication(3, time.time(), "mill-1")])
            await until(lambda: len(everything.alarms()) == 3)
            await until(lambda: len(of_machine.alarms()) == len(mills.alarms()) == 2)
            # A client that comes later asks for what is active.
            late, subscription = await hears(of_plant)
            kind = of_plant.get_node(ua.NodeId(ua.ObjectIds.ConditionType))
            number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
            await kind.call_method("0:ConditionRefresh", number)
            await until(lambda: len(late.events) == 3)
            nobody = ua.Variant(9_999, ua.VariantType.UInt32)
            with pytest.raises(ua.UaError, match="subscription"):
                await kind.call_method("0:ConditionRefresh", nobody)
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


def test_nobody_takes_reads_changes_or_ends_a_subscription_of_another_user(tmp_path):
    async def live():
        async with (
            plant(tmp_path) as (publisher, port),
            await client_of(tmp_path, port, "plant", "plants-secret") as of_plant,
            await client_of(tmp_path, port, "plant", "plants-secret") as of_plant_too,
            await client_of(tmp_path, port, "mill", "mills-secret") as of_mill,
        ):
            heard, subscription = await hears(of_plant)
            number, asked = subscription.subscription_id, of_mill.uaclient.session
            refused = [
                asked.transfer_subscriptions(ua.TransferSubscriptionsParameters([number], True)),
                asked.republish(number, 1),
                asked.delete_subscriptions([number]),
                asked.set_publishing_mode(ua.SetPublishingModeParameters(False, [number])),
                asked.create_monitored_items(ua.CreateMonitoredItemsParameters(number)),
            ]
            for one in refused:
                with pytest.raises(ua.UaError, match="BadUserAccessDenied"):
                    await one
            publisher.publish([bad(2, "lathe-1")])
            await until(heard.alarms)
            # A client that has lost its connection takes its own along.
            params = ua.TransferSubscriptionsParameters([number], True)
            (moved,) = await of_plant_too.uaclient.transfer_subscriptions(params)
            return moved.StatusCode

    assert asyncio.run(live()).is_good()


def test_the_history_of_a_value_is_read_whole_in_either_direction_by_who_may(tmp_path):
    async def live():
        async with (
            plant(tmp_path) as (_, port),
            await client_of(tmp_path, port, "mill", "mills-secret") as client,
        ):
            value = client.get_node("ns=2;s=mill-1.Displacement.x")
            begun, ended = (datetime.fromtimestamp(AT + k, UTC) for k in (100, 5_180))
            found = {
                "whole": await value.read_raw_history(begun, ended),
                "newest": await value.read_raw_history(None, None, numvalues=2),
                "first": await value.read_raw_history(begun, None, numvalues=3),
                "status": await client.get_node("ns=2;s=mill-1.Status").read_raw_history(
                    begun, None, numvalues=1
                ),
                "shown": await value.read_attribute(ua.AttributeIds.Historizing),
            }
            for name in ("lathe-1.Displacement.x", "mill-1.Handshake", "mill-1"):
                with pytest.raises(ua.UaError) as error:
                    await client.get_node(f"ns=2;s={name}").read_raw_history(begun, ended)
                found[name] = type(error.value).__name__
            return found

    found = asyncio.run(live())
    whole = np.arange(100, 5_181)
    np.testing.assert_allclose([one.Value.Value for one in found["whole"]], whole + 1, rtol=1e-12)
    times = [one.SourceTimestamp.timestamp() for one in found["whole"]]
    np.testing.assert_allclose(times, AT + whole, rtol=0, atol=1e-5)
    assert [one.StatusCode.name for one in found["newest"]] == ["BadNoCommunication", "Good"]
    assert found["newest"][0].Value.Value is None
    assert [round(one.Value.Value) for one in found["first"]] == [101, 102, 103]
    assert found["status"][0].Value.Value == "reading-missing:T2_degC"
    assert found["shown"].Value.Value is True
    assert found["lathe-1.Displacement.x"] == "BadUserAccessDenied"
    assert found["mill-1.Handshake"] == found["mill-1"] == "BadHistoryOperationUnsupported"
