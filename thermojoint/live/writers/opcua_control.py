"""Values that a control writes by OPC UA: enable, heartbeat, acknowledged offsets (the handshake).

``NAME.Control.Enable``, ``NAME.Control.Heartbeat``, ``NAME.Control.Acknowledged.AXIS`` and, for
axes with a slope, ``NAME.Control.AcknowledgedSlope.AXIS`` below the machine's ThermalDisplacement;
the service's own ``Heartbeat`` is in the folder of the machines.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from asyncua import ua
from asyncua.server import Server

from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import Answer
from thermojoint.live.publication import Layout
from thermojoint.live.publisher import Publisher
from thermojoint.live.writers.opcua import NAMESPACE

#: Interval at which the service's heartbeat is checked, s.
_BEAT_S = 0.5
_WRAP = 1 << 32

#: Receives a value written by the control of a machine.
AnswerHandler = Callable[[str, Answer], None]


async def add_controls(
    server: Server, controls: Mapping[str, Layout], receive: AnswerHandler
) -> ua.NodeId:
    """Add the variables that controls write; return the node of the service's heartbeat.

    The server contains the machines already. `controls` maps a machine to the layout of the values
    that its control receives.
    """
    index = await server.get_namespace_index(NAMESPACE)
    heartbeat = ua.NodeId("Heartbeat", index)
    await server.nodes.objects.add_variable(
        heartbeat, f"{index}:Heartbeat", 0, ua.VariantType.UInt32
    )
    for machine, layout in controls.items():
        parent = server.get_node(ua.NodeId(f"{machine}.ThermalDisplacement", index))
        at = ua.NodeId(f"{machine}.Control", index)
        folder = await parent.add_folder(at, f"{index}:Control")
        starts: dict[str, tuple[Any, ua.VariantType]] = {
            "Enable": (False, ua.VariantType.Boolean),
            "Heartbeat": (0, ua.VariantType.UInt32),
            **dict.fromkeys(acknowledged(layout), (math.nan, ua.VariantType.Double)),
        }
        for name, start in starts.items():
            at = ua.NodeId(f"{machine}.Control.{name}", index)
            node = await folder.add_variable(at, f"{index}:{name}", *start)
            await node.set_writable()
            server.iserver.aspace.add_datachange_callback(
                at, ua.AttributeIds.Value, _write_handler(machine, name, layout, receive)
            )
    return heartbeat


def _write_handler(
    machine: str, name: str, layout: Layout, receive: AnswerHandler
) -> Callable[[Any, ua.DataValue], Awaitable[None]]:
    async def on_write(handle: Any, written: ua.DataValue) -> None:  # noqa: ANN401
        # A value marked as bad arrives as None.
        receive(machine, answer_of(name, layout, written.Value.Value if written.Value else None))

    return on_write


def acknowledged(layout: Layout) -> list[str]:
    """Return the names of the acknowledged values, in the order of an answer."""
    return [
        *(f"Acknowledged.{axis}" for axis in layout.controls),
        *(f"AcknowledgedSlope.{line.axis}" for line in layout.lines),
    ]


def answer_of(name: str, layout: Layout, value: Any) -> Answer:  # noqa: ANN401
    """Return a value written by a control as an answer; None for a bad value."""
    if name == "Enable":
        return Answer(enabled=value is True)
    if name == "Heartbeat":
        return Answer(heartbeat=value)
    metres = math.nan if value is None else MICRO * value
    levers = zip(acknowledged(layout), layout.levers.tolist(), strict=True)
    return Answer(
        acknowledged=[lever * metres if name == one else math.nan for one, lever in levers]
    )


async def write_heartbeat(server: Server, node: ua.NodeId, publisher: Publisher) -> None:
    """Write the service's heartbeat into its variable until cancelled."""
    while True:
        value = ua.DataValue(ua.Variant(publisher.heartbeat % _WRAP, ua.VariantType.UInt32))
        await server.write_attribute_value(node, value)
        await asyncio.sleep(_BEAT_S)
