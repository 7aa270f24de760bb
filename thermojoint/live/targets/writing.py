"""Offsets and slopes of a machine written into its control by OPC UA; its side of the handshake.

Every cycle reads the values in force in the control and reports them to the service. Nothing is
written unless the file of the target enables it, the handshake stands, and the control still has
the values written last; from a value changed by somebody else the service continues. A single write
changes a value by no more than its limit. If the connection is lost, the control keeps the last
value.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import Client, ua

from thermojoint.artefacts.errors import InputError
from thermojoint.compensation.offsets.handshake import DIFFERS, STANDS, Answer
from thermojoint.live.audit import Audit
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.opcua_session import LOST, TIMEOUT_S, Endpoint, client_of, endpoint_of
from thermojoint.live.processing import Fleet, receive_answer
from thermojoint.live.publisher import Publisher
from thermojoint.live.reconnecting import Attempts
from thermojoint.live.settings import Service
from thermojoint.live.targets.control import in_units, next_value
from thermojoint.live.targets.settings import TargetFile, Write, read_target, writes_of

#: Time for which the control counts as away after somebody else has changed a value, or the service
#: cannot agree with it, s; on its return the service continues from the values in it.
AWAY_S = 3.0


def target_of(
    service: Service, machine: str, model: LoadedModel
) -> tuple[TargetFile, Endpoint] | None:
    """Return the target of a machine and how it is reached; None without one.

    Raises
    ------
    InputError
        Its file, a certificate or a secret cannot be used.
    """
    path = service.machines[machine].target
    if path is None:
        return None
    given = read_target(path, model.output.output if model.output else None)
    handshake = service.machines[machine].handshake
    if handshake is not None and given.every_s >= handshake.heartbeat_s:
        raise InputError(
            f"{path}: every_s {given.every_s:g} is not shorter than handshake.heartbeat_s "
            f"{handshake.heartbeat_s:g} of machines.{machine}: no offset would follow; make it "
            "shorter"
        )
    return given, endpoint_of(given, service.folder, str(path))


@dataclass(frozen=True, eq=False)
class TargetWriter:
    """Writer into one control."""

    machine: str
    #: Axes of the offsets.
    names: tuple[str, ...]
    given: TargetFile
    endpoint: Endpoint
    publisher: Publisher
    fleet: Fleet
    audit: Audit

    async def run(self) -> None:
        """Write until cancelled; reconnect whenever the connection is lost."""
        async for attempt in Attempts():
            try:
                async with await client_of(self.endpoint) as client:
                    await self._check(client)
                    attempt.succeeded()
                    self._log("connected", f"target {self.given.url}")
                    await self._write_offsets(client)
            except InputError as error:
                self._log("target-refused", str(error))
            except LOST as error:
                text = str(error) or type(error).__name__
                self._log("disconnected", f"target {self.given.url}: {text}")

    async def _check(self, client: Client) -> None:
        """Refuse a control with another compensation, to overwrite no values of somebody else."""
        control = self.given.control
        for name in self.names:
            wanted = {control.switch: 1.0, control.slope: 0.0, control.reference: 0.0}
            if section := self.given.slopes.get(name):
                reference = in_units(control.reference, section.reference)
                wanted = {control.switch: control.with_slope, control.reference: reference}
            for quantity, value in wanted.items():
                (found,) = await self._read(client, [Write(quantity, name, 0.0)])
                if abs(found - value) > 1e-3 * quantity.step:
                    raise InputError(
                        f"{quantity.name} of axis {name} is {found:.10g}; set it to {value:.10g} "
                        "while the machine stands"
                    )

    async def _write_offsets(self, client: Client) -> None:
        writes = writes_of(self.given, self.names)
        levers = self.publisher.newest[self.machine].layout.levers.tolist()
        last: list[float] | None = None
        changed = -math.inf
        for heartbeat in itertools.count():
            found = await self._read(client, writes)
            clock = time.monotonic()
            published = self.publisher.newest[self.machine]
            if (
                last is None
                or published.handshake == DIFFERS
                or any(
                    abs(one - other) > 0.5 * write.quantity.step
                    for write, one, other in zip(writes, found, last, strict=True)
                )
            ):
                changed = clock
            enabled = self.given.enable and clock - changed > AWAY_S
            in_force = tuple(
                lever * write.quantity.metres * value
                for write, lever, value in zip(writes, levers, found, strict=True)
            )
            receive_answer(self.fleet, self.machine, Answer(enabled, heartbeat, in_force), clock)
            wanted = [*published.offsets.tolist(), *published.slopes.tolist()]
            goals = [
                next_value(write.quantity, now, value, write.most)
                for write, now, value in zip(writes, found, wanted, strict=True)
            ]
            last = found
            if not self.given.enable:
                self._log_dry_run(writes, found, goals)
            elif enabled and published.handshake == STANDS and goals != found:
                await self._write(client, writes, goals)
                last = goals
            await asyncio.sleep(self.given.every_s)

    async def _read(self, client: Client, values: Sequence[Write]) -> list[float]:
        nodes = [client.get_node(self.given.node(one.quantity, one.axis)) for one in values]
        # Not asyncio.wait_for: before Python 3.12 it loses a cancellation, with which the service
        # ends, if a value arrives at the same moment.
        async with asyncio.timeout(TIMEOUT_S):
            found = await client.read_values(nodes)
        for one, value in zip(values, found, strict=True):
            if not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{one.quantity.name} of axis {one.axis} is {value!r}, no number")
        return [float(value) for value in found]

    async def _write(self, client: Client, writes: Sequence[Write], goals: Sequence[float]) -> None:
        for (quantity, name, _), goal in zip(writes, goals, strict=True):
            node = self.given.node(quantity, name)
            what, value = f"write {node}", f" = {goal:.10g}"
            self.audit.written("service", self.given.url, what, self.machine, value)
            kind = ua.VariantType.Int32 if quantity.whole else ua.VariantType.Double
            value = ua.Variant(int(goal) if quantity.whole else goal, kind)
            async with asyncio.timeout(TIMEOUT_S):
                await client.get_node(node).write_value(ua.DataValue(value))

    def _log_dry_run(
        self, writes: Sequence[Write], found: Sequence[float], goals: Sequence[float]
    ) -> None:
        """Log the writes that would be made, at the limited rate of the log."""
        for (quantity, name, _), now, goal in zip(writes, found, goals, strict=True):
            node = self.given.node(quantity, name)
            values = f"{goal:.10g} {quantity.unit}, is {now:.10g}"
            self._log("dry-run", f"would write {node} = {values}")

    def _log(self, kind: str, text: str) -> None:
        self.fleet.log.say(time.time(), kind, text, self.machine)
