"""Companion specifications: a client of theirs finds machines, identifications and components."""

import asyncio
import contextlib

import pytest
from asyncua import Client, ua
from live_parts import free_port, serving, until

from thermojoint.artefacts.errors import InputError
from thermojoint.live.settings import service_from_data

UA = "http://opcfoundation.org/UA/"
IDENTIFICATION = {
    "manufacturer": "Maschinenfabrik Beispiel",
    "serial_number": "4711-{machine}",
    "product_instance_uri": "https://beispiel.example/4711-{machine}",
    "model": "BX 500",
    "year_of_construction": 2019,
}


def file_of(model, companion, **machine):
    return {
        "folder": "state",
        "models": {"m": {"file": str(model)}},
        "machines": {"mill": {"model": "m", "source": "log", **machine}},
        "sources": {"log": {"kind": "csv", "path": "{machine}.csv"}},
        "opcua": {"port": free_port(), "security": "none", "companion": companion},
    }


@pytest.fixture(scope="module", params=["machinery", "machine-tool"])
def seen(request, model, tmp_path_factory):
    """What a client of two machines finds that looks at them by a specification."""
    base = tmp_path_factory.mktemp(request.param)
    data = file_of(model, request.param, identification=IDENTIFICATION, count=2)
    with asyncio.Runner() as runner:
        stack = contextlib.AsyncExitStack()
        runner.run(stack.enter_async_context(serving(data, base)))
        yield lambda look: runner.run(found_by_a_client(data, look))
        runner.run(stack.aclose())


async def found_by_a_client(data, look):
    url = f"opc.tcp://127.0.0.1:{data['opcua']['port']}/thermojoint"
    async with Client(url) as client:
        return await look(client)


async def children_of(node):
    return {(await one.read_browse_name()).Name: one for one in await node.get_children()}


async def namespaces_of(client):
    return {name: k for k, name in enumerate(await client.get_namespace_array())}


async def machines_of(client):
    index = (await namespaces_of(client))[f"{UA}Machinery/"]
    return await children_of(client.get_node(ua.NodeId(1001, index)))


def test_a_machine_is_found_and_identified_as_the_specification_says(seen, request):
    async def look(client):
        index = await namespaces_of(client)
        machines = await machines_of(client)
        mill = machines["mill-2"]
        blocks = await mill.get_child(f"{index[f'{UA}Machinery/']}:MachineryBuildingBlocks")
        found = {"machines": set(machines), "blocks": set(await children_of(blocks))}
        place = await mill.get_child(f"{index[f'{UA}DI/']}:Identification")
        found["type"] = await (
            client.get_node(await place.read_type_definition())
        ).read_browse_name()
        found["machine"] = {
            name: await one.read_value() for name, one in (await children_of(place)).items()
        }
        estimator = client.get_node("ns=2;s=mill-2.Components.ThermalDisplacementEstimator")
        place = await estimator.get_child(f"{index[f'{UA}DI/']}:Identification")
        found["estimator"] = {
            name: await one.read_value() for name, one in (await children_of(place)).items()
        }
        names = [
            (await one.read_browse_name()).Name
            for one in await client.get_node("ns=2;s=mill-2.Displacement.x").get_path()
        ]
        return found | {"path": names}

    found = seen(look)
    assert found["machines"] == {"mill-1", "mill-2"}
    assert {"Identification", "Components"} <= found["blocks"]
    tool = "Tool" if request.node.callspec.params["seen"] == "machine-tool" else ""
    assert found["type"].Name == f"Machine{tool}IdentificationType"
    assert found["machine"] == {
        "Manufacturer": ua.LocalizedText("Maschinenfabrik Beispiel"),
        "SerialNumber": "4711-mill-2",
        "ProductInstanceUri": "https://beispiel.example/4711-mill-2",
        "Model": ua.LocalizedText("BX 500"),
        "YearOfConstruction": 2019,
    }
    assert found["estimator"]["Model"] == ua.LocalizedText("model.json")
    assert len(found["estimator"]["SerialNumber"]) == 16
    assert found["path"][1:] == [
        *("Objects", "Machines", "mill-2", "Monitoring", "ThermalDisplacement"),
        *("Displacement", "x"),
    ]


@pytest.mark.parametrize("seen", ["machine-tool"], indirect=True)
def test_a_machine_tool_says_nothing_of_what_the_service_does_not_know(seen):
    async def look(client):
        index = await namespaces_of(client)
        mill = (await machines_of(client))["mill-1"]
        kind = client.get_node(await mill.read_type_definition())
        # What asyncua alone refuses: a structure with an option set that is an unsigned integer.
        output = client.get_node(ua.NodeId(3012, index[f"{UA}Machinery/Jobs/"]))
        mode = client.get_node("ns=2;s=mill-1.Monitoring.MachineTool.OperationMode")
        program = client.get_node("ns=2;s=mill-1.Production.ActiveProgram.Name")
        codes = [
            (await node.read_data_value(raise_on_bad_status=False)).StatusCode.name
            for node in (mode, program)
        ]
        names = [(await one.read_browse_name()).to_string() for one in (kind, output)]
        return names, codes, index

    names, codes, index = seen(look)
    tool, jobs = index[f"{UA}MachineTool/"], index[f"{UA}Machinery/Jobs/"]
    assert names == [f"{tool}:MachineToolType", f"{jobs}:OutputInformationDataType"]
    assert codes == ["BadNotConnected"] * 2


@pytest.mark.parametrize("seen", ["machinery"], indirect=True)
def test_a_client_of_the_machines_folder_hears_of_a_machine_without_readings(seen):
    class Heard(list):
        def event_notification(self, event):
            self.append(event)

    async def look(client):
        index = (await namespaces_of(client))[f"{UA}Machinery/"]
        heard = Heard()
        subscription = await client.create_subscription(50.0, heard)
        await subscription.subscribe_alarms_and_conditions(ua.NodeId(1001, index))
        number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
        kind = client.get_node(ua.NodeId(ua.ObjectIds.ConditionType))
        await kind.call_method("0:ConditionRefresh", number)
        await until(lambda: heard)
        return [(one.SourceName, one.Message.Text) for one in heard]

    assert ("mill-1", "the displacement of mill-1 is bad: no-sample") in seen(look)


@pytest.mark.parametrize("seen", ["machinery"], indirect=True)
def test_nobody_writes_the_nodes_of_a_specification(seen):
    """Some of them are writable by their node sets, such as the location of a machine's type."""

    async def look(client):
        index = (await namespaces_of(client))[f"{UA}Machinery/"]
        with pytest.raises(ua.UaError):
            await client.get_node(ua.NodeId(6029, index)).write_value("here")

    seen(look)


def test_a_server_without_a_specification_loads_none(model, tmp_path):
    data = file_of(model, "none")

    async def live():
        async with serving(data, tmp_path):
            return await found_by_a_client(data, namespaces_of)

    assert len(asyncio.run(live())) == 3


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        ({}, "machines.mill.identification: missing; opcua.companion needs it"),
        (
            {"count": 2, "identification": IDENTIFICATION | {"serial_number": "4711"}},
            "identification.serial_number: is for 2 machines",
        ),
    ],
)
def test_machines_without_an_identification_of_their_own_are_refused(
    model, machine, said, tmp_path
):
    with pytest.raises(InputError, match=said):
        service_from_data(file_of(model, "machinery", **machine), "service.toml", tmp_path)
