"""Companion specifications: a client of theirs finds machines, identifications and components."""

import asyncio

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


def found_by_a_client(data, base, look):
    async def live():
        async with (
            serving(data, base),
            Client(f"opc.tcp://127.0.0.1:{data['opcua']['port']}/thermojoint") as client,
        ):
            return await look(client)

    return asyncio.run(live())


async def children_of(node):
    return {(await one.read_browse_name()).Name: one for one in await node.get_children()}


async def namespaces_of(client):
    return {name: k for k, name in enumerate(await client.get_namespace_array())}


async def machines_of(client):
    index = (await namespaces_of(client))[f"{UA}Machinery/"]
    return await children_of(client.get_node(ua.NodeId(1001, index)))


@pytest.mark.parametrize("companion", ["machinery", "machine-tool"])
def test_a_machine_is_found_and_identified_as_the_specification_says(model, companion, tmp_path):
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

    data = file_of(model, companion, identification=IDENTIFICATION, count=2)
    found = found_by_a_client(data, tmp_path, look)
    assert found["machines"] == {"mill-1", "mill-2"}
    assert {"Identification", "Components"} <= found["blocks"]
    tool = companion == "machine-tool"
    kind = "MachineToolIdentificationType" if tool else "MachineIdentificationType"
    assert found["type"].Name == kind
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


def test_a_machine_tool_says_nothing_of_what_the_service_does_not_know(model, tmp_path):
    async def look(client):
        index = await namespaces_of(client)
        mill = (await machines_of(client))["mill"]
        kind = client.get_node(await mill.read_type_definition())
        # What asyncua alone refuses: a structure with an option set that is an unsigned integer.
        output = client.get_node(ua.NodeId(3012, index[f"{UA}Machinery/Jobs/"]))
        mode = client.get_node("ns=2;s=mill.Monitoring.MachineTool.OperationMode")
        program = client.get_node("ns=2;s=mill.Production.ActiveProgram.Name")
        codes = [
            (await node.read_data_value(raise_on_bad_status=False)).StatusCode.name
            for node in (mode, program)
        ]
        names = [(await one.read_browse_name()).to_string() for one in (kind, output)]
        return names, codes, index

    data = file_of(model, "machine-tool", identification=IDENTIFICATION)
    names, codes, index = found_by_a_client(data, tmp_path, look)
    tool, jobs = index[f"{UA}MachineTool/"], index[f"{UA}Machinery/Jobs/"]
    assert names == [f"{tool}:MachineToolType", f"{jobs}:OutputInformationDataType"]
    assert codes == ["BadNotConnected"] * 2


def test_a_client_of_the_machines_folder_hears_of_a_machine_without_readings(model, tmp_path):
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

    data = file_of(model, "machinery", identification=IDENTIFICATION)
    said = "the displacement of mill is bad: no-sample"
    assert ("mill", said) in found_by_a_client(data, tmp_path, look)


def test_nobody_writes_the_nodes_of_a_specification(model, tmp_path):
    """Some of them are writable by their node sets, such as the location of a machine's type."""

    async def look(client):
        index = (await namespaces_of(client))[f"{UA}Machinery/"]
        with pytest.raises(ua.UaError):
            await client.get_node(ua.NodeId(6029, index)).write_value("here")

    found_by_a_client(file_of(model, "machinery", identification=IDENTIFICATION), tmp_path, look)


def test_a_server_without_a_specification_loads_none(model, tmp_path):
    names = found_by_a_client(file_of(model, "none"), tmp_path, namespaces_of)
    assert len(names) == 3


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
