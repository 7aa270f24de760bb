"""Output interfaces (MQTT, OPC UA, HTTP, SHDR), imported only if configured."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Coroutine, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.compensation.offsets.handshake import Answer
from thermojoint.live.arrivals import Arrival
from thermojoint.live.control_message import answer_of
from thermojoint.live.former_models import former_of, read_record, roll_back
from thermojoint.live.processing import Fleet, Machine, postpone, receive_answer
from thermojoint.live.publication import micrometres
from thermojoint.live.running import Running
from thermojoint.live.settings import HandshakeSection, HttpServer, OpcuaServer, Service

#: Time for the response before the service restarts, s.
_ANSWER_S = 0.5

if TYPE_CHECKING:
    from thermojoint.live.companion_models import Identity
    from thermojoint.live.scene import Scene


async def open_outputs(running: Running) -> list[Coroutine[Any, Any, None]]:
    """Open the output interfaces, and return the coroutines that serve them."""
    service, publisher, outputs = running.service, running.publisher, []
    mqtt, shdr = service.given.mqtt, service.given.shdr
    if mqtt is not None:
        from thermojoint.live.mqtt_session import address_of
        from thermojoint.live.writers.mqtt import write_topics

        address, controls = address_of(mqtt, "mqtt"), _handshakes(service, "mqtt")
        audit = running.accounts.audit
        outputs.append(write_topics(publisher, address, mqtt, running.fleet, controls, audit))
    if service.given.opcua is not None:
        outputs += await _opcua_server(running, service.given.opcua)
    if any(machine.target for machine in service.machines.values()):
        outputs += _target_writers(running)
    if service.given.http is not None:
        outputs.append(_http_server(running, service.given.http))
    if shdr is not None:
        from thermojoint.live.limited_socket import listening
        from thermojoint.live.writers.shdr import serve_agents

        most = shdr.most_connections
        bound_socket = listening("shdr", shdr.address, shdr.port, most, most)
        outputs.append(serve_agents(publisher, bound_socket, shdr.heartbeat_s))
    return outputs


def _target_writers(running: Running) -> list[Coroutine[Any, Any, None]]:
    """Return the writers into the controls of the machines with a target."""
    from thermojoint.live.targets.writing import TargetWriter, target_of

    found, audit = [], running.accounts.audit
    for name, machine in running.fleet.machines.items():
        target = target_of(running.service, name, machine.model)
        if target is not None:
            names = machine.model.layout.controls
            writer = TargetWriter(name, names, *target, running.publisher, running.fleet, audit)
            found.append(writer.run())
    return found


def _http_server(running: Running, section: HttpServer) -> Coroutine[Any, Any, None]:
    from thermojoint.live.http.backend import Backend, MachineInfo
    from thermojoint.live.http.server import open_http, serve_http

    service = running.service
    folder = service.folder
    machines = running.fleet.machines.items()
    about = {
        name: MachineInfo(
            layout=machine.model.layout,
            kind=machine.model.estimator.kind,
            model=machine.model.file,
            since=running.archive.begun(name),
            valid=machine.model.ranges,
            probes=tuple(machine.model.layout.readings[machine.model.rule.wanted :]),
        )
        for name, machine in machines
    }
    backend = Backend(
        running.publisher,
        running.archive,
        about,
        running.metrics.registry,
        _scenes(running),
        {name: partial(_residuals_of, one) for name, one in machines if one.model.residuals},
        {name: partial(_handshake_of, one) for name, one in machines if one.model.handshake},
        lambda name: former_of(read_record(folder), folder, name),
        partial(_roll_back, running),
        {
            name: (one.user, partial(_read_answer, running.fleet, name))
            for name, one in _handshakes(service, "http").items()
        },
        partial(_postpone, running),
        partial(_queue_readings, running),
        lambda: {
            "disk": "full" if running.disk_space.full else "ok",
            "reserve_h": round(running.reserve_h, 1),
        },
    )
    opened = open_http(section, backend, running.accounts, folder)
    running.fleet.log.say(time.time(), "listening", opened.url)
    return serve_http(opened, running.stop)


def _postpone(running: Running, machine: str) -> None:
    """Postpone the requested displacement reading of a machine."""
    changed = postpone(running.fleet, machine, time.time())
    if changed is not None:
        running.publisher.publish([changed])


def _queue_readings(running: Running, machine: str, given: Mapping[str, float]) -> bool:
    """Queue displacement readings entered by an operator, um."""
    names, now = running.fleet.machines[machine].model.layout.readings, time.time()
    return _queue(running, Arrival(machine, now, [given.get(name) for name in names], now))


def _queue(running: Running, arrival: Arrival) -> bool:
    """Queue an arrival from an interface of the service; False if the queue is full."""
    try:
        running.arrivals.put_nowait([arrival])
    except asyncio.QueueFull:
        return False
    return True


def _roll_back(running: Running, machine: str) -> None:
    """Pin a machine to its former model, and reload after the response has been sent."""
    roll_back(running.service, machine)
    asyncio.get_running_loop().call_later(_ANSWER_S, running.reload)


def _scenes(running: Running) -> dict[str, Scene]:
    """Return the scenes of the machines whose models have one."""
    from thermojoint.live.scene import scene_of

    machines, models = running.service.machines, running.service.given.models
    return {
        name: scene_of(file, machine.model.estimator, partial(_state_of, machine))
        for name, machine in running.fleet.machines.items()
        if (file := models[machines[name].model].scene) is not None
    }


def _residuals_of(machine: Machine) -> dict[str, float | None] | None:
    """Return reading minus prediction of each sensor of a machine, K; None before the first sample.

    A faulty sensor is visible here before and after it is excluded; a deviation common to all
    sensors is the model's error.
    """
    model, state = machine.model, machine.state
    if model.residuals is None or state.usable.number == 0:
        return None
    values, _ = model.intake.convert(tuple(state.usable.readings.tolist()), state.cold)
    differences = model.residuals(model.estimator, state.estimator_state, np.array(values)).tolist()
    return {
        name: round(value, 4) if math.isfinite(value) else None
        for name, value in zip(model.layout.readings, differences, strict=False)
    }


def _handshake_of(machine: Machine) -> dict[str, Any]:
    """Return the handshake state of a machine's control."""
    handshake, clock = machine.state.handshake, time.monotonic()
    layout = machine.model.layout
    acts, axes = handshake.acknowledged / layout.levers, [one.axis for one in layout.lines]
    slopes = micrometres(axes, acts[len(layout.controls) :])
    return {
        "state": handshake.state,
        "enabled": handshake.enabled,
        "heartbeat": handshake.heartbeat,
        "heartbeat_age_s": round(clock - handshake.beaten, 1)
        if math.isfinite(handshake.beaten)
        else None,
        "acknowledged_um": micrometres(layout.controls, acts[: len(layout.controls)]),
        **({"acknowledged_slopes_um_per_m": slopes} if axes else {}),
    }


def _state_of(machine: Machine) -> Array:
    return machine.state.estimator_state


async def _opcua_server(running: Running, section: OpcuaServer) -> list[Coroutine[Any, Any, None]]:
    from thermojoint.live.writers.opcua import ServerContext, open_server, serve_nodes
    from thermojoint.live.writers.opcua_control import add_controls, write_heartbeat

    machines = {
        name: (machine.model.layout, machine.model.rule.wanted)
        for name, machine in running.fleet.machines.items()
    }
    service, log, publisher = running.service, running.fleet.log, running.publisher
    handshakes = _handshakes(service, "opcua")
    owners = {name: one.user for name, one in handshakes.items() if one.user is not None}
    context = ServerContext(running.accounts, service.folder, log, owners, running.archive)
    server, nodes = await open_server(
        section, context, publisher, machines, partial(_queue, running), _identities(running)
    )
    controls = {name: machines[name][0] for name in handshakes}
    heartbeat = await add_controls(server, controls, partial(_answer, running.fleet))
    return [serve_nodes(server, nodes, publisher), write_heartbeat(server, heartbeat, publisher)]


def _identities(running: Running) -> dict[str, Identity]:
    """Return the identifications of the machines that have one."""
    from thermojoint.live.companion_models import Identity

    sections, machines = running.service.machines, running.fleet.machines
    return {
        name: Identity(section, machine.model.file, machine.model.digest)
        for name, machine in machines.items()
        if (section := sections[name].identification) is not None
    }


def _handshakes(service: Service, by: str) -> dict[str, HandshakeSection]:
    """Return the handshakes of the machines whose controls answer by an interface."""
    return {
        name: one.handshake
        for name, one in service.machines.items()
        if one.handshake is not None and one.handshake.by == by
    }


def _read_answer(fleet: Fleet, machine: str, body: bytes) -> None:
    """Receive the message of a control; raise ValueError if it is not an answer."""
    _answer(fleet, machine, answer_of(body, fleet.machines[machine].model.layout))


def _answer(fleet: Fleet, machine: str, given: Answer) -> None:
    receive_answer(fleet, machine, given, time.monotonic())
