#!/usr/bin/python3
"""LinuxCNC: a HAL component that moves axes by the offsets of a thermojoint service.

A self-contained file: it runs on the control's system Python and needs only its standard library
and the module `hal`. A thread reads the service's stream (HTTP, server-sent events), another one
reports the offsets in force in the control; the main loop moves ``axis.L.eoffset-counts`` at a
limited rate. The control accumulates changes of the counts, and drops them while the machine is off
or not homed, so every step starts from the request that the control reports
(``axis.L.eoffset-request``). This also allows a restarted component to continue.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import signal
import ssl
import sys
import threading
import time
import urllib.request
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

#: Period of the loop, and longest time for the control to accept a step, s.
PERIOD_S, ACCEPTED_S = 0.05, 1.0
#: First and longest delay before the stream is opened again, s.
FIRST_S, LONGEST_S = 0.5, 10.0
#: Interval of the answers to the service, s.
ANSWER_S = 1.0
#: Time for which the service is notified after a control was switched off or not homed, s.
AWAY_S = 3.0
READY = ("motion.motion-enabled", "motion.is-all-homed")
#: Number of periods whose travel a late loop makes up for.
MOST_PERIODS = 4
#: Steps of an offset, per µm.
PER_UM = 10
#: Name of the component in HAL and prefix of its signals; number of names to try.
NAME, MOST_NAMES = "thermojoint", 100
#: Pins read from an axis: the component's own counts, the control's request, the offset in force.
WATCHED = ("-counts", "-request", "")
#: States: following the service; holding, then returning to zero without it.
FOLLOW, HOLD, RETURN = "follow", "hold", "return"


class Limits(NamedTuple):
    """Limits of the component."""

    #: Largest rate, µm/s.
    rate: float
    #: Largest accepted offset, µm.
    largest: float
    #: Silence after which the service counts as lost, s; time for which the offsets are then held.
    silence: float
    hold: float


class Message(NamedTuple):
    """Last message of the service: its time (s), and offsets by axis (µm) or None without any."""

    at: float
    offsets: Mapping[str, float] | None


class Axis(NamedTuple):
    """State of an axis: last written counts, expected request (counts), and time of writing (s)."""

    counts: int
    expected: int
    since: float


def message_of(data: Mapping[str, Any], clock: float, limits: Limits, before: Message) -> Message:
    """Return the newest message of the service after an event at a time (s).

    While the handshake is broken it has no offsets, and the time of the last one with offsets.
    Without a publication in the event's data nothing has changed.

    Raises
    ------
    ValueError
        An offset is missing, not a number, or beyond the limit.
    """
    offsets = before.offsets
    for one in data["publications"]:
        stands = one["handshake"] in (None, "stands")
        offsets = {a.lower(): value for a, value in one["offsets_um"].items()} if stands else None
        for value in (offsets or {}).values():
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not abs(value) <= limits.largest:
                raise ValueError(f"offsets {one['offsets_um']} µm: not within the limit")
    return Message(before.at if offsets is None else clock, offsets)


def state_of(on: bool, clock: float, message: Message, limits: Limits) -> str:
    """Return the state of the offsets at a time (s)."""
    silence = clock - message.at
    if on and message.offsets is not None and silence <= limits.silence:
        return FOLLOW
    return HOLD if on and silence <= limits.silence + limits.hold else RETURN


def goal_of(state: str, message: Message, letter: str, requested: int) -> int:
    """Return the target of an axis, counts; an axis without an offset from the service stays."""
    offset = (message.offsets or {}).get(letter)
    if state == FOLLOW and offset is not None:
        return round(PER_UM * offset)
    return 0 if state == RETURN else requested


def stepped(axis: Axis, request: int, goal: int, allowed: int, clock: float) -> Axis:
    """Return an axis one cycle later, at a time (s).

    `request` is that reported by the control, `goal` the target, `allowed` the largest step, in
    counts.
    """
    if request != axis.expected and clock - axis.since < ACCEPTED_S:
        return axis
    step = max(-allowed, min(allowed, goal - request))
    return Axis(axis.counts + step, request + step, clock)


class Connection:
    """Connection to the service.

    `listen` changes the newest `message`, and whether the service `differs` from the offsets in
    force. `answer` sends whether the control has `enabled` them, and those `in_force`, µm.
    """

    def __init__(self, given: argparse.Namespace, limits: Limits, axes: tuple[str, ...]) -> None:
        self.axes, self.message, self._limits = axes, Message(time.monotonic(), None), limits
        self.differs = False
        self.enabled, self.in_force = False, dict.fromkeys(axes, 0.0)
        self._given = given

    def listen(self) -> None:
        """Read the stream endlessly; open it again whenever it ends."""
        delay = FIRST_S
        while True:
            try:
                with self._open(f"stream?machine={self._given.machine}&every_s=0.1") as stream:
                    for line in stream:
                        if line.startswith(b"data:"):
                            data = json.loads(line[5:])
                            self.differs = any(
                                one["handshake"] == "differs" for one in data["publications"]
                            )
                            self.message = message_of(
                                data, time.monotonic(), self._limits, self.message
                            )
                            delay = FIRST_S
            except Exception as error:  # after any error the offsets are held, then return to zero
                print(f"thermojoint: {error}", file=sys.stderr, flush=True)
            self.message = Message(self.message.at, None)
            time.sleep(delay)
            delay = min(2.0 * delay, LONGEST_S)

    def answer(self) -> None:
        """Send the control's side of the handshake to the service, endlessly."""
        heartbeat = 0
        while True:
            time.sleep(ANSWER_S)
            heartbeat = (heartbeat + 1) % (1 << 31)
            offsets = {axis.upper(): round(value, 4) for axis, value in self.in_force.items()}
            data = {"enable": self.enabled, "heartbeat": heartbeat, "offsets_um": offsets}
            with suppress(Exception), self._open("control", json.dumps(data).encode()):
                pass

    def _open(self, what: str, body: bytes | None = None) -> Any:  # noqa: ANN401
        given = self._given
        token = Path(given.token_file).read_text("utf-8").strip()
        place = what if body is None else f"machines/{given.machine}/{what}"
        headers = {"Authorization": f"Bearer {token}"}
        request = urllib.request.Request(f"{given.url}/api/{place}", body, headers)
        # Read each time, because the service renews its certificate.
        context = ssl.create_default_context(cafile=given.ca_file) if given.ca_file else None
        return urllib.request.urlopen(request, timeout=given.silence_s, context=context)


def arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", required=True, help="http://host:port of the service")
    parser.add_argument("--machine", required=True, help="its name in the service")
    parser.add_argument("--token-file", required=True, help="file with a token of the service")
    parser.add_argument("--ca-file", help="certificate of the service or its authority (PEM)")
    parser.add_argument("--axes", required=True, help="letters of the axes, such as xz")
    parser.add_argument("--rate-um-s", type=float, default=1.0)
    parser.add_argument("--largest-um", type=float, default=500.0)
    parser.add_argument("--silence-s", type=float, default=10.0)
    parser.add_argument("--hold-s", type=float, default=60.0)
    parser.add_argument("--units-per-mm", type=float, default=1.0, help="of the control's axes")
    return parser.parse_args()


def is_alive(pid: int) -> bool:
    """Return whether a process exists and is not a zombie."""
    try:
        return ") Z" not in Path(f"/proc/{pid}/stat").read_text("utf-8")
    except OSError:
        return False


def linked(hal: Any, axes: tuple[str, ...]) -> Any:  # noqa: ANN401
    """Return the HAL component, linked to the control.

    HAL keeps the pins and the name of a killed component. Its successor uses the next name, and
    takes over the signals, which keep their values meanwhile.
    """
    kinds = {"on": hal.HAL_BIT, "following": hal.HAL_BIT, "heartbeat": hal.HAL_U32}
    driven = {"counts": hal.HAL_S32, "enable": hal.HAL_BIT, "clear": hal.HAL_BIT,
              "scale": hal.HAL_FLOAT}  # fmt: skip
    kinds.update({f"{axis}.{name}": kind for axis in axes for name, kind in driven.items()})
    former, component = "", None
    for number in range(1, MOST_NAMES):
        name = NAME if number == 1 else f"{NAME}-{number}"
        try:
            component = hal.component(name)
            break
        except hal.error:
            former = name
    if component is None:
        raise SystemExit("too many components of this name; start the control again")
    if former and is_alive(hal.get_value(f"{former}.pid")):
        raise SystemExit(f"{former} runs already")
    component.newpin("pid", hal.HAL_U32, hal.HAL_OUT)
    for pin, kind in kinds.items():
        component.newpin(pin, kind, hal.HAL_IN if pin == "on" else hal.HAL_OUT)
    component["pid"] = os.getpid()
    signals = {signal["NAME"] for signal in hal.get_info_signals()}
    for pin, kind in kinds.items():
        net = f"{NAME}-{pin.replace('.', '-')}"
        if net not in signals:
            hal.new_sig(net, kind)
            if "." in pin:
                hal.connect("axis.{}.eoffset-{}".format(*pin.split(".")), net)
        elif former and pin != "on":
            # A signal has one writer, and takes the value of the pin that is connected to it.
            component[pin] = hal.get_value(f"{former}.{pin}")
            hal.disconnect(f"{former}.{pin}")
        hal.connect(f"{name}.{pin}", net)
    component.ready()
    return component


def run(hal: Any, component: Any, service: Connection, limits: Limits, scale: float) -> None:  # noqa: ANN401
    """Move the axes endlessly; `scale` is the length of one count in the units of the control."""
    axes: dict[str, Axis] = {}
    clock, away, credit, heartbeat = time.monotonic(), -AWAY_S, 0.0, 0
    while True:
        before, clock = clock, time.monotonic()
        # A delayed loop makes up for a few periods only.
        credit += PER_UM * limits.rate * (clock - before)
        credit = min(credit, max(1.0, MOST_PERIODS * PERIOD_S * PER_UM * limits.rate))
        message = service.message
        state = state_of(bool(component["on"]), clock, message, limits)
        farthest = 0
        for letter in service.axes:
            read = (hal.get_value(f"axis.{letter}.eoffset{name}") for name in WATCHED)
            counts, request, offset_in_force = read
            requested = round(request / scale)
            service.in_force[letter] = offset_in_force / (scale * PER_UM)
            axis = axes.get(letter) or Axis(counts, requested, clock)
            zero = state == RETURN and requested == 0
            enabled = bool(component[f"{letter}.enable"])
            component[f"{letter}.scale"] = scale
            component[f"{letter}.enable"], component[f"{letter}.clear"] = not zero, zero
            # Changes of the counts before the control is enabled are lost.
            if enabled and not zero:
                goal = goal_of(state, message, letter, requested)
                axis = stepped(axis, requested, goal, int(credit), clock)
            farthest = max(farthest, abs(axis.counts - counts))
            axes[letter] = axis
            component[f"{letter}.counts"] = axis.counts
        credit -= farthest
        heartbeat = (heartbeat + 1) % (1 << 31)
        # A control that is switched off loses its offset, which the service must notice. If the
        # service disagrees with the offsets in force, it continues from them as well.
        if service.differs or not all(hal.get_value(name) for name in READY):
            away = clock
        service.enabled = bool(component["on"]) and clock - away > AWAY_S
        component["following"], component["heartbeat"] = state == FOLLOW, heartbeat
        time.sleep(PERIOD_S)


def main() -> None:
    """Move the axes until the control ends."""
    given = arguments()
    axes = tuple(given.axes.lower())
    limits = Limits(given.rate_um_s, given.largest_um, given.silence_s, given.hold_s)
    hal = importlib.import_module("hal")
    component = linked(hal, axes)
    service = Connection(given, limits, axes)
    for work in (service.listen, service.answer):
        threading.Thread(target=work, daemon=True).start()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    run(hal, component, service, limits, given.units_per_mm / (1000.0 * PER_UM))


if __name__ == "__main__":
    main()
