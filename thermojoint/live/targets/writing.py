"""The offsets of a machine written into its control by OPC UA; the control's side of the handshake.

Every cycle reads what acts in the control and tells the service so. Nothing is written unless the
file of the target enables it, the handshake stands, and the control still has what was written
last: a value that somebody else has changed is where the service continues. A single write changes
a value by no more than its limit. Where the connection is lost, the control keeps the last value.
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
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.handshake import DIFFERS, STANDS, Answer
from thermojoint.live.audit import Audit
from thermojoint.live.floor import Floor, answer
from thermojoint.live.hub import Hub
from thermojoint.live.opcua_session import LOST, TIMEOUT_S, Reached, client_of, reached_of
from thermojoint.live.reconnecting import FIRST_S, next_delay
from thermojoint.live.served import Served
from thermojoint.live.settings import Service
from thermojoint.live.targets.control import Quantity, next_value
from thermojoint.live.targets.settings import TargetFile, read_target

#: After somebody else has changed a value, or the service cannot agree with it, the control counts
#: as away for this long, s; on its return the service continues from what it has.
AWAY_S = 3.0


def target_of(service: Service, machine: str, served: Served) -> tuple[TargetFile, Reached] | None:
    """Return the target of a machine and how it is reached; None without one.

    Raises
    ------
    InputError
        Its file, a certificate or a secret cannot be used.
    """
    path = service.machines[machine].target
    if path is None:
        return None
    given = read_target(path, served.output.output if served.output else None)
    return given, reached_of(given, service.folder, str(path))


@dataclass(frozen=True, eq=False)
class Writer:
    """What writes into one control.

    Attributes
    ----------
    machine : str
    names : tuple of str
        Axes of the offsets.
    given : TargetFile
    reached : Reached
        How its server is reached.
    hub : Hub
    floor : Floor
    audit : Audit
    """

    machine: str
    names: tuple[str, ...]
    given: TargetFile
    reached: Reached
    hub: Hub
    floor: Floor
    audit: Audit

    async def run(self) -> None:
        """Write for ever; connect again whenever the connection is lost."""
        delay = FIRST_S
        while True:
            try:
                async with await client_of(self.reached) as client:
                    await self._check(client)
                    delay = FIRST_S
                    self._say("connected", f"target {self.given.url}")
                    await self._follow(client)
            except InputError as error:
                self._say("target-refused", str(error))
            except LOST as error:
                text = str(error) or type(error).__name__
                self._say("disconnected", f"target {self.given.url}: {text}")
            await asyncio.sleep(delay)
            delay = next_delay(delay)

    async def _check(self, client: Client) -> None:
        """Refuse a control that compensates otherwise: no value of somebody else is overwritten."""
        control = self.given.control
        wanted = {control.switch: 1.0} | dict.fromkeys(control.zeros, 0.0)
        for name in self.names:
            for quantity, value in wanted.items():
                (found,) = await self._read(client, quantity, [name])
                if found != value:
                    raise InputError(
                        f"{quantity.name} of axis {name} is {found:g}; set it to {value:g} while "
                        "the machine stands"
                    )

    async def _follow(self, client: Client) -> None:
        offset = self.given.control.offset
        last: list[float] | None = None
        changed = -math.inf
        for beats in itertools.count():
            found = await self._read(client, offset, self.names)
            clock = time.monotonic()
            said = self.hub.newest[self.machine]
            if (
                last is None
                or said.handshake == DIFFERS
                or any(
                    abs(one - other) > 0.5 * offset.step
                    for one, other in zip(found, last, strict=True)
                )
            ):
                changed = clock
            enabled = self.given.enable and clock - changed > AWAY_S
            acts = tuple(offset.metres * value for value in found)
            answer(self.floor, self.machine, Answer(enabled, beats, acts), clock)
            most = MICRO * self.given.largest_step_um
            goals = [
                next_value(offset, now, float(metres), most)
                for now, metres in zip(found, said.offsets, strict=True)
            ]
            last = found
            if not self.given.enable:
                self._show(found, goals)
            elif enabled and said.handshake == STANDS and goals != found:
                await self._write(client, goals)
                last = goals
            await asyncio.sleep(self.given.every_s)

    async def _read(self, client: Client, quantity: Quantity, names: Sequence[str]) -> list[float]:
        nodes = [client.get_node(self.given.node(quantity, name)) for name in names]
        found = await asyncio.wait_for(client.read_values(nodes), TIMEOUT_S)
        for name, value in zip(names, found, strict=True):
            if not isinstance(value, int | float) or not math.isfinite(value):
                raise InputError(f"{quantity.name} of axis {name} is {value!r}, no number")
        return [float(value) for value in found]

    async def _write(self, client: Client, goals: Sequence[float]) -> None:
        offset = self.given.control.offset
        for name, goal in zip(self.names, goals, strict=True):
            node = self.given.node(offset, name)
            self.audit.written("service", self.given.url, f"write {node} = {goal:g}", self.machine)
            kind = ua.VariantType.Int32 if offset.whole else ua.VariantType.Double
            value = ua.Variant(int(goal) if offset.whole else goal, kind)
            write = client.get_node(node).write_value(ua.DataValue(value))
            await asyncio.wait_for(write, TIMEOUT_S)

    def _show(self, found: Sequence[float], goals: Sequence[float]) -> None:
        """Say what would be written, at the rate of the log."""
        offset = self.given.control.offset
        for name, now, goal in zip(self.names, found, goals, strict=True):
            node = self.given.node(offset, name)
            self._say("dry-run", f"would write {node} = {goal:g} {offset.unit}, is {now:g}")

    def _say(self, kind: str, text: str) -> None:
        self.floor.log.say(time.time(), kind, text, self.machine)
