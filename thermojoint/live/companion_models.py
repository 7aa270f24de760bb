"""Companion specifications in the service's OPC UA server: Machinery and Machine Tools.

OPC 40001-1 (Machinery): a machine's identification, its components, its building blocks, in the
Machines folder. OPC 40501-1 (Machine Tools): the machine as a MachineToolType. The node sets are
published by the OPC Foundation under its MIT licence, which each of them contains.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from typing import Any, NamedTuple
from xml.etree import ElementTree

from asyncua import ua
from asyncua.server import Server

from thermojoint.live.settings import CompanionModel, IdentificationSection

_UA = "http://opcfoundation.org/UA/"
_NODE_SET = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
_MACHINERY = ("Di", "Machinery")
#: Node sets of each model, in the order of their dependencies.
_NODE_SETS = {
    "machinery": _MACHINERY,
    "machine-tool": (*_MACHINERY, "IA", "ISA95.JobControl", "Machinery.Jobs", "MachineTool"),
}
#: UInt16, Byte, UInt32, UInt64: types of an option set besides OptionSet.
_UNSIGNED = {"i=3", "i=5", "i=7", "i=9"}
#: Node ids in the specifications: Machines, types of an identification and of components.
_MACHINES, _IDENTIFICATION, _OF_COMPONENT, _COMPONENTS = 1001, 1012, 1005, 1006
_MACHINE_TOOL, _TOOL_IDENTIFICATION = 13, 11
#: Properties of an identification that are localized, and those that DI does not define.
_LOCALIZED = {"Manufacturer", "Model", "ComponentName"}
_OF_MACHINERY = {"Location", "YearOfConstruction"}
#: Mandatory values of a machine tool that are unknown to a service beside its control.
_UNKNOWN = (
    "Monitoring.MachineTool.OperationMode",
    "Production.ActiveProgram.Name",
    "Production.ActiveProgram.NumberInList",
    "Production.ActiveProgram.State.CurrentState",
    "Production.ActiveProgram.State.CurrentState.Id",
    "Production.ActiveProgram.State.CurrentState.Number",
)


class Identity(NamedTuple):
    """Identification of a machine, and of the model that estimates its displacement."""

    machine: IdentificationSection
    #: Name of the model's file, and its digest.
    model: str
    digest: str


@dataclass(frozen=True)
class Companion:
    """Loaded specifications."""

    #: The Machines folder.
    machines: ua.NodeId
    #: Indices of the namespaces of DI, of Machinery, and of the service.
    devices: int
    machinery: int
    own: int
    #: Index of the namespace of Machine Tools, if it is loaded.
    machine_tool: int | None
    #: Identities by machine.
    identities: Mapping[str, Identity]


async def load_models(
    server: Server, model: CompanionModel, own: int, identities: Mapping[str, Identity]
) -> Companion:
    """Load the node sets of a model into a server that is initialised, but not started.

    `own` is the index of the service's namespace; `identities` are by machine.
    """
    for name in _NODE_SETS[model]:
        path = files("thermojoint.live") / "nodesets" / f"Opc.Ua.{name}.NodeSet2.xml"
        await server.import_xml(xmlstring=without_option_sets(path.read_bytes()))
    devices = await server.get_namespace_index(f"{_UA}DI/")
    machinery = await server.get_namespace_index(f"{_UA}Machinery/")
    tool = (
        await server.get_namespace_index(f"{_UA}MachineTool/") if model == "machine-tool" else None
    )
    machines = ua.NodeId(_MACHINES, machinery)
    return Companion(machines, devices, machinery, own, tool, identities)


def without_option_sets(content: bytes) -> bytes:
    """Return a node set in which option sets are plain unsigned integers.

    asyncua only accepts definitions of enumerations and structures, and would refuse the structures
    with such an option set (OutputInfoType of Machinery Jobs).
    """
    root = ElementTree.fromstring(content)
    for one in root.iter(f"{_NODE_SET}UADataType"):
        definition = one.find(f"{_NODE_SET}Definition")
        bases = {
            reference.text
            for reference in one.iter(f"{_NODE_SET}Reference")
            if reference.get("IsForward") == "false"
        }
        if definition is not None and definition.get("IsOptionSet") and bases & _UNSIGNED:
            one.remove(definition)
    return ElementTree.tostring(root)


async def add_machine(server: Server, companion: Companion, machine: str) -> None:
    """Add a machine with its identification, its components and its building blocks."""
    identity, tool = companion.identities[machine], companion.machine_tool
    own, machinery = companion.own, companion.machinery
    place, components, blocks = (
        ua.NodeId(f"{machine}{part}", own)
        for part in ("", ".Components", ".MachineryBuildingBlocks")
    )
    shown = ua.QualifiedName(machine, own)
    kind = ua.NodeId(_IDENTIFICATION, machinery)
    items = []
    if tool is not None:
        # Mandatory parts only: optional ones would promise values that do not exist.
        await server.get_node(companion.machines).add_object(
            place, shown, ua.NodeId(_MACHINE_TOOL, tool), instantiate_optional=False
        )
        kind = ua.NodeId(_TOOL_IDENTIFICATION, tool)
        unknown = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadNotConnected))
        for name in _UNKNOWN:
            await server.write_attribute_value(ua.NodeId(f"{machine}.{name}", own), unknown)
        there = server.get_node(ua.NodeId(f"{machine}.Identification", own))
        await server.delete_nodes([there], recursive=True)
    else:
        items.append(object_item(place, shown, (companion.machines, ua.ObjectIds.Organizes)))
    given = identity.machine.model_dump(exclude_none=True)
    items += _identified(companion, machine, machine, kind, given)
    estimator = f"{machine}.Components.ThermalDisplacementEstimator"
    of_estimator = {
        "manufacturer": "thermojoint",
        "serial_number": identity.digest[:16],
        "model": identity.model,
        "software_revision": version("thermojoint"),
    }
    called = ua.QualifiedName("Components", machinery)
    above = (place, ua.ObjectIds.HasAddIn)
    items.append(object_item(components, called, above, ua.NodeId(_COMPONENTS, machinery)))
    called = ua.QualifiedName("ThermalDisplacementEstimator", own)
    above = (components, ua.ObjectIds.HasComponent)
    items.append(object_item(ua.NodeId(estimator, own), called, above))
    kind = ua.NodeId(_OF_COMPONENT, machinery)
    items += _identified(companion, machine, estimator, kind, of_estimator)
    called = ua.QualifiedName("MachineryBuildingBlocks", machinery)
    above = (place, ua.ObjectIds.HasComponent)
    items.append(object_item(blocks, called, above, ua.NodeId(ua.ObjectIds.FolderType)))
    for result in await server.iserver.isession.add_nodes(items):
        result.StatusCode.check()
    for name in ("Identification", "Components"):
        block = ua.NodeId(f"{machine}.{name}", own)
        folder = server.get_node(blocks)
        await folder.add_reference(block, ua.ObjectIds.HasAddIn, True, False)


def _identified(
    companion: Companion, machine: str, of: str, kind: ua.NodeId, given: Mapping[str, Any]
) -> Iterable[ua.AddNodesItem]:
    """Yield the identification of a machine or of one of its components."""
    place = ua.NodeId(f"{of}.Identification", companion.own)
    name = ua.QualifiedName("Identification", companion.devices)
    yield object_item(place, name, (ua.NodeId(of, companion.own), ua.ObjectIds.HasAddIn), kind)
    for key, value in given.items():
        named = key.title().replace("_", "")
        variant = ua.VariantType.UInt16
        if isinstance(value, str):
            variant, value = ua.VariantType.String, value.replace("{machine}", machine)
        if named in _LOCALIZED:
            variant, value = ua.VariantType.LocalizedText, ua.LocalizedText(value)
        index = companion.machinery if named in _OF_MACHINERY else companion.devices
        yield ua.AddNodesItem(
            RequestedNewNodeId=ua.NodeId(f"{of}.Identification.{named}", companion.own),
            BrowseName=ua.QualifiedName(named, index),
            NodeClass=ua.NodeClass.Variable,
            ParentNodeId=place,
            ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasProperty),
            TypeDefinition=ua.NodeId(ua.ObjectIds.PropertyType),
            NodeAttributes=ua.VariableAttributes(
                DisplayName=ua.LocalizedText(named),
                Value=ua.Variant(value, variant),
                DataType=ua.NodeId(int(variant.value)),
                ValueRank=-1,
                AccessLevel=ua.AccessLevel.CurrentRead.mask,
                UserAccessLevel=ua.AccessLevel.CurrentRead.mask,
            ),
        )


def object_item(
    nodeid: ua.NodeId,
    name: ua.QualifiedName,
    parent: tuple[ua.NodeId, int],
    kind: ua.NodeId | None = None,
) -> ua.AddNodesItem:
    """Return an object to add below a parent, which is given with the type of the reference."""
    return ua.AddNodesItem(
        RequestedNewNodeId=nodeid,
        BrowseName=name,
        NodeClass=ua.NodeClass.Object,
        ParentNodeId=parent[0],
        ReferenceTypeId=ua.NodeId(parent[1]),
        TypeDefinition=kind or ua.NodeId(ua.ObjectIds.BaseObjectType),
        NodeAttributes=ua.ObjectAttributes(DisplayName=ua.LocalizedText(name.Name)),
    )
