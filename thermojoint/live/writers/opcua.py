"""The service's own OPC UA server: an object for each machine, values with their status codes.

``Objects/Machines/NAME/Monitoring/ThermalDisplacement`` contains Displacement, Band, Offset, Slope,
Reference (P0), Detail, Reading and Probe, with a variable for each axis or channel. Values are only
computed when they are read or subscribed to, so machines without readers cost nothing.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from asyncua import ua
from asyncua.server import Server

from thermojoint.artefacts.errors import InputError
from thermojoint.live.accounts import Accounts
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival
from thermojoint.live.certificates import APPLICATION, application_uri, opcua_identity
from thermojoint.live.companion_models import (
    Companion,
    Identity,
    add_machine,
    load_models,
    object_item,
)
from thermojoint.live.ip_address import in_url
from thermojoint.live.log_lines import EventLog
from thermojoint.live.opcua_access import AccessControl, restrict
from thermojoint.live.opcua_internals import disconnect_ended, limit_connections, value_of
from thermojoint.live.opcua_values import Variable, data_value, variables_of
from thermojoint.live.publication import Layout
from thermojoint.live.publisher import Publisher
from thermojoint.live.settings import OpcuaServer
from thermojoint.live.times import since_1970
from thermojoint.live.trust_list import TrustList, contents_of
from thermojoint.live.writers.opcua_alarms import Alarms, add_alarms, send_alarms
from thermojoint.live.writers.opcua_history import ArchiveHistory, is_archived

#: The service's namespace; its nodes are ``ns=2;s=NAME.Displacement.x``.
NAMESPACE = "urn:thermojoint:live:machines"
#: UNECE Recommendation 20: unit to its common code, which OPC UA (Part 8) encodes as a number.
_UNITS = {"µm": "4H", "°C": "CEL", "K": "KEL", "W": "WTT", "Pa": "PAL", "1": "C62", "mm": "MMT"}
_FOLDERS = ("Displacement", "Band", "Offset", "Slope", "Reference", "Detail", "Reading", "Probe")


@dataclass(frozen=True, eq=False)
class Nodes:
    """The variables of every machine in a server's address space."""

    #: Machine to its (variable, value attribute).
    variables: Mapping[str, list[tuple[Variable, Any]]]
    alarms: Alarms


async def add_machines(
    server: Server,
    publisher: Publisher,
    machines: Mapping[str, tuple[Layout, int]],
    readings: bool,
    given: Callable[[Arrival], object],
    companion: Companion | None = None,
) -> dict[str, list[tuple[Variable, Any]]]:
    """Add the objects of all machines; return their variables, in the form of `Nodes.variables`.

    The server is initialised, but not started; the publisher has a publication of each machine.
    `machines` maps names to the layout and the number of readings in every sample. Variables of the
    readings are added if `readings` is true. `given` is called with each written reading. The
    machines follow the specification `companion`.
    """
    index = await server.register_namespace(NAMESPACE)
    session, space = server.iserver.isession, server.iserver.aspace
    root = ua.NodeId("Machines", index)
    if companion is None:
        await server.nodes.objects.add_folder(root, f"{index}:Machines")
    units: dict[str, ua.NodeId] = {}
    added: dict[str, list[tuple[Variable, Any]]] = {}
    for machine, (layout, wanted) in machines.items():
        at = _object(machine, machine, root, index)
        monitoring = _object(f"{machine}.Monitoring", "Monitoring", at[0], index)
        place = _object(
            f"{machine}.ThermalDisplacement", "ThermalDisplacement", monitoring[0], index
        )
        items = [at[1], monitoring[1], place[1]]
        if companion is not None:
            await add_machine(server, companion, machine)
            # The type of a machine tool already contains its Monitoring.
            items = items[1:] if companion.machine_tool is None else items[2:]
        variables = list(variables_of(layout, readings, wanted))
        used = {variable.folder for variable in variables}
        folders = {"": place[0]}
        for folder in (folder for folder in _FOLDERS if folder in used):
            folders[folder], item = _object(f"{machine}.{folder}", folder, place[0], index)
            items.append(item)
        ids = [node_of(machine, variable, index) for variable in variables]
        items += [
            _variable(nodeid, variable, folders[variable.folder], index)
            for nodeid, variable in zip(ids, variables, strict=True)
        ]
        for result in await session.add_nodes(items):
            result.StatusCode.check()
        added[machine] = []
        for nodeid, variable in zip(ids, variables, strict=True):
            if variable.unit:
                await _with_unit(server, units, nodeid, variable.unit, index)
            if variable.writable:
                k = layout.readings.index(variable.name)
                take = _write_handler(given, machine, len(layout.readings), k)
                space.set_attribute_value_setter(nodeid, ua.AttributeIds.Value, take)
            read_current = partial(_current, publisher, machine, variable)
            space.set_attribute_value_callback(nodeid, ua.AttributeIds.Value, read_current)
            added[machine].append((variable, value_of(server, nodeid)))
    return added


def node_of(machine: str, variable: Variable, index: int) -> ua.NodeId:
    """Return the node id of a variable: ``NAME.Displacement.x``."""
    return ua.NodeId(".".join(filter(None, (machine, variable.folder, variable.name))), index)


def _current(publisher: Publisher, machine: str, variable: Variable, *_: object) -> ua.DataValue:
    latest = publisher.newest[machine]
    return data_value(variable.kind, *variable.value(latest), latest)


def _write_handler(
    given: Callable[[Arrival], object], machine: str, count: int, k: int
) -> Callable[[Any, Any, ua.DataValue], None]:
    def take(node: Any, attribute: Any, written: ua.DataValue) -> None:  # noqa: ANN401
        arrival = probe_reading(machine, count, k, written, time.time())
        if arrival is not None:
            given(arrival)

    return take


def probe_reading(
    machine: str, count: int, k: int, written: ua.DataValue, now: float
) -> Arrival | None:
    """Return a written reading; None if the value is not a number.

    It is reading `k` of `count` of the machine. Without a time it is of `now`, s since 1970.
    """
    value = written.Value.Value if written.Value else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    readings: list[float | None] = [None] * count
    readings[k] = float(value)
    stamp = written.SourceTimestamp
    return Arrival(machine, now if stamp is None else since_1970(stamp), readings, now)


def _object(
    name: str, shown: str, parent: ua.NodeId, index: int
) -> tuple[ua.NodeId, ua.AddNodesItem]:
    nodeid = ua.NodeId(name, index)
    called = ua.QualifiedName(shown, index)
    return nodeid, object_item(nodeid, called, (parent, ua.ObjectIds.HasComponent))


def _variable(
    nodeid: ua.NodeId, variable: Variable, parent: ua.NodeId, index: int
) -> ua.AddNodesItem:
    access = ua.AccessLevel.CurrentRead.mask
    if is_archived(variable):
        access |= ua.AccessLevel.HistoryRead.mask
    if variable.writable:
        access |= ua.AccessLevel.CurrentWrite.mask
    kind = ua.ObjectIds.AnalogUnitType if variable.unit else ua.ObjectIds.BaseDataVariableType
    return ua.AddNodesItem(
        RequestedNewNodeId=nodeid,
        BrowseName=ua.QualifiedName(variable.name, index),
        NodeClass=ua.NodeClass.Variable,
        ParentNodeId=parent,
        ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasComponent),
        TypeDefinition=ua.NodeId(kind),
        NodeAttributes=ua.VariableAttributes(
            DisplayName=ua.LocalizedText(variable.name),
            Value=ua.Variant(None, ua.VariantType.Null),
            DataType=ua.NodeId(int(variable.kind.value)),
            ValueRank=-1,
            AccessLevel=access,
            UserAccessLevel=access,
            Historizing=is_archived(variable),
        ),
    )


async def _with_unit(
    server: Server, units: dict[str, ua.NodeId], nodeid: ua.NodeId, unit: str, index: int
) -> None:
    """Add the unit to a variable; variables with the same unit share the property."""
    node = server.get_node(nodeid)
    if unit not in units:
        information = ua.EUInformation(
            NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
            UnitId=int.from_bytes(_UNITS[unit].encode()) if unit in _UNITS else -1,
            DisplayName=ua.LocalizedText(unit),
            Description=ua.LocalizedText(unit),
        )
        made = await node.add_property(
            ua.NodeId(f"EngineeringUnits.{unit}", index), "0:EngineeringUnits", information
        )
        units[unit] = made.nodeid
    else:
        await node.add_reference(units[unit], ua.ObjectIds.HasProperty, True, False)


async def notify_subscribers(publisher: Publisher, nodes: Nodes) -> None:
    """Send new values to subscribers until cancelled."""
    with publisher.subscribe() as subscription:
        while True:
            for machine in await subscription.wait():
                latest = publisher.newest[machine]
                for variable, attribute in nodes.variables[machine]:
                    if attribute.datachange_callbacks:
                        value = data_value(variable.kind, *variable.value(latest), latest)
                        for handle, call in list(attribute.datachange_callbacks.items()):
                            await call(handle, value)
            await asyncio.sleep(0)


def fresh_server(section: OpcuaServer) -> Server:
    """Return a server with name and address that is not open yet."""
    server = Server()
    server.name = "thermojoint"
    server.product_uri = server.manufacturer_name = APPLICATION
    server.application_type = ua.ApplicationType.Server
    server.set_endpoint(f"opc.tcp://{in_url(section.address)}:{section.port}/thermojoint")
    return server


@dataclass(frozen=True, eq=False)
class ServerContext:
    """Access control of the server."""

    accounts: Accounts
    #: Folder of the service, with its certificate and rejected client certificates.
    folder: Path
    log: EventLog
    #: Machine to the only user who may write its control's side of the handshake.
    controls: Mapping[str, str]
    archive: Archive


async def open_server(
    section: OpcuaServer,
    context: ServerContext,
    publisher: Publisher,
    machines: Mapping[str, tuple[Layout, int]],
    given: Callable[[Arrival], object],
    identities: Mapping[str, Identity],
) -> tuple[Server, Nodes]:
    """Open the service's OPC UA server.

    Publisher, machines and `given` are those of `add_machines`; `identities` are those of the
    machines, for a companion specification.

    Raises
    ------
    InputError
        There are no users, a file is unusable, or the address is in use.
    """
    encrypted = section.security == "sign-and-encrypt"
    login = context.accounts.users_file is not None
    if not login and encrypted:
        raise InputError(
            "opcua: no one could log in; name a file of users, and add them: thermojoint users"
        )
    if section.trusted is not None:
        contents_of(section.trusted)
    server = fresh_server(section)
    await server.init()
    if encrypted:
        own = opcua_identity(section, context.folder)
        await server.set_application_uri(application_uri(own))
        await server.load_certificate(own.certificate)
        await server.load_private_key(own.key)
    trust = TrustList(section.trusted, context.folder / "rejected")
    access = AccessControl(context.accounts, login, trust, context.log, context.controls, machines)
    server.iserver.set_user_manager(access)
    restrict(server, access, section)
    index = await server.register_namespace(NAMESPACE)
    companion = None
    if section.companion != "none":
        begun = time.monotonic()
        companion = await load_models(server, section.companion, index, identities)
        spent = time.monotonic() - begun
        context.log.say(time.time(), "companion", f"{section.companion} loaded in {spent:.2f} s")
    variables = await add_machines(server, publisher, machines, section.readings, given, companion)
    archived = {
        node_of(machine, variable, index): (machine, variable)
        for machine, some in variables.items()
        for variable, _ in some
        if is_archived(variable)
    }
    server.iserver.history_manager.set_storage(ArchiveHistory(context.archive, archived))
    try:
        await server.start()
    except OSError as error:
        raise InputError(
            f"opcua: {section.address}:{section.port}: {error.strerror}; take another port"
        ) from error
    limit_connections(server, section.most_sessions)
    folders = () if companion is None else (companion.machines,)
    alarms = await add_alarms(server, access, index, folders)
    return server, Nodes(variables, alarms)


async def serve_nodes(server: Server, nodes: Nodes, publisher: Publisher) -> None:
    """Send new values until the task is cancelled, then close the server."""
    try:
        await asyncio.gather(
            notify_subscribers(publisher, nodes),
            send_alarms(nodes.alarms, publisher),
            disconnect_ended(server),
        )
    finally:
        await server.stop()
