"""Thousands of malformed readings at every door: no crash, no wrong value, no growth.

python -m benchmarks.live_fuzz --count 5000

Each door gets well-formed readings of one machine and, between them, damaged ones: other types,
NaN, arrays, long texts, broken encodings, times that are none. The estimates must be those of the
well-formed readings alone; nothing may be raised, and neither what waits nor what is remembered may
grow. The interfaces are called where the network would call them.
"""

from __future__ import annotations

import json
import math
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from random import Random
from typing import Any

from asyncua import ua

from benchmarks.study import options_of
from thermojoint.artefacts.tables.clock import Hands
from thermojoint.live import processing
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import initial_state
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.processing import Fleet, Machine
from thermojoint.live.readers import csv_lines, mqtt, opcua
from thermojoint.live.samples import AssemblyState
from thermojoint.live.settings import MqttSource, WatchdogSection
from thermojoint.live.writers.opcua import probe_reading

START = 1_772_431_200.0
MACHINE = "mill"
Door = Callable[[Random, LoadedModel, float, bool], list[Arrival | Note]]
_LARGEST = 16_384


def good_readings(model: LoadedModel, k: int) -> list[float]:
    """Return what a machine reads in a second that is well."""
    return [20.0 + 0.5 * n + math.sin(k / 50.0 + n) for n in range(model.intake.wanted)]


def values(draw: Random) -> Any:
    """Return something that is no reading."""
    return draw.choice(
        [
            None,
            True,
            "23.5",
            "",
            "x" * draw.randrange(1, 3000),
            [1.0] * draw.randrange(0, 500),
            {"a": [{}] * 20},
            math.nan,
            -math.inf,
            1e308,
            10**400,
            9.9e37,
            "\ud800",
            "∂T",
        ]
    )


def times(draw: Random) -> Any:
    """Return something that is no time of now."""
    return draw.choice(
        [
            None,
            True,
            "yesterday",
            "2026-13-45T99:00:00Z",
            "9999-12-31T23:59:59.999999-23:59",
            math.nan,
            math.inf,
            -1.0,
            1e18,
            10**400,
            [START],
            {},
            START - 1e6,
            START + 1e8,
        ]
    )


def mqtt_door(draw: Random, model: LoadedModel, now: float, well: bool) -> list[Arrival | Note]:
    """One message: a topic and its payload."""
    names = model.intake.names
    topics = mqtt.topics_of(
        MqttSource(kind="mqtt", topic="hall/{machine}", largest_message=_LARGEST), {MACHINE: names}
    )
    content: Any = {
        "time": now,
        **dict(zip(names, good_readings(model, int(now - START)), strict=False)),
    }
    topic = f"hall/{MACHINE}"
    if well:
        return [mqtt.item_of(topics, topic, json.dumps(content).encode())]
    payload = b""
    kind = draw.randrange(8)
    if kind == 0:
        payload = draw.randbytes(draw.randrange(0, 400))
    elif kind == 1:
        text = json.dumps(content).encode()
        payload = text[: draw.randrange(len(text))]
    elif kind == 2:
        content["time"] = times(draw)
    elif kind == 3:
        payload = b"[" * draw.choice([10, 5000]) + b"1"
    elif kind == 4:
        topic = draw.choice(["hall/", "hall/other", "hall/../mill", "x", "hall/mill/x", "\0"])
    elif kind == 5:
        payload = b'{"time": 1, "a": "' + b"x" * draw.randrange(_LARGEST, 8 * _LARGEST) + b'"}'
    elif kind == 6:
        # One reading among good ones that is of another type: the message is none.
        name = draw.choice(names[: model.intake.wanted])
        content[name] = draw.choice([True, "23.5", [1.0] * 400, {"a": 1.0}, "x" * 3000])
    else:
        content = draw.choice([values(draw), {"time": now}, {draw.random(): 1}, [content]])
    if not payload:
        payload = json.dumps(content, default=str).encode("utf-8", "replace")
    return [mqtt.item_of(topics, topic, payload)]


def csv_door(draw: Random, model: LoadedModel, now: float, well: bool) -> list[Arrival | Note]:
    """One line of a pipe."""
    names = {name: name for name in model.intake.names}
    reader = csv_lines.CsvReader(MACHINE, Path("-"), names, model.intake.wanted, 0.0, follow=True)
    cells = [repr(now), *map(repr, good_readings(model, int(now - START)))]
    line = ",".join(cells).encode()
    first = ",".join(("time_s", *model.intake.names[: model.intake.wanted]))
    header = csv_lines.header_of([first, line.decode()], reader)
    if not well:
        kind = draw.randrange(5)
        if kind == 0:
            line = draw.randbytes(draw.randrange(1, 400)).replace(b"\n", b"")
        elif kind == 1:
            cells[0] = str(times(draw))
        elif kind == 2:
            del cells[draw.randrange(len(cells))]
        elif kind == 3:
            cells.append("1" * draw.randrange(1, 5000))
        else:
            cells[0] = '"' + "9" * 400
        line = line if kind == 0 else ",".join(cells).encode("utf-8", "replace")
    return csv_lines.items_in(reader, header, line, Hands())[0]


def opcua_door(draw: Random, model: LoadedModel, now: float, well: bool) -> list[Arrival | Note]:
    """One value of each variable, or one that is damaged; and one that a user writes."""
    count = len(model.intake.names)
    stamp = datetime.fromtimestamp(now, UTC)
    if well:
        found = [
            opcua.item_of(
                MACHINE, (k,), count, ua.DataValue(ua.Variant(one), SourceTimestamp=stamp)
            )
            for k, one in enumerate(good_readings(model, int(now - START)))
        ]
        return opcua.in_order(found)
    at = draw.choice(
        [None, datetime.min, datetime.max, stamp.replace(year=1601), stamp.replace(year=2199)]
    )
    content = draw.choice(
        [True, "20.0", "x" * 3000, b"\xff" * 100, [1.0] * 1000, None, datetime.now(UTC), 20.0]
    )
    value = ua.DataValue(
        ua.Variant(content) if content is not None else None, SourceTimestamp=at, ServerTimestamp=at
    )
    found = [opcua.item_of(MACHINE, (draw.randrange(count),), count, value)]
    written = probe_reading(MACHINE, count, count - 1, ua.DataValue(ua.Variant("x")), now)
    return [*opcua.in_order(found), *([written] if written else [])]


DOORS: dict[str, Door] = {"mqtt": mqtt_door, "csv": csv_door, "opcua": opcua_door}


def fleet_of(model: LoadedModel) -> Fleet:
    """Return a fleet of one machine without a store."""
    mill = Machine(model, 1, initial_state(MACHINE, model, START), None, 0.0, START)
    return Fleet({MACHINE: mill}, EventLog(), fresh_metrics(), 60.0, 1e9, WatchdogSection())


def estimates(
    door: Door, model: LoadedModel, count: int, seed: int, damaged: bool
) -> Iterator[tuple[float, ...]]:
    """Yield the estimates of a run, with damaged readings between the others or without."""
    draw, fleet = Random(seed), fleet_of(model)
    mill = fleet.machines[MACHINE]
    for k in range(count):
        now = START + float(k)
        arrivals: list[Arrival | Note] = []
        if damaged:
            for _ in range(draw.randrange(1, 4)):
                arrivals += door(draw, model, now, False)
        arrivals += door(draw, model, now, True)
        for one in arrivals:
            if isinstance(one, Note):
                fleet.log.say(now, one.kind, one.text, one.machine)
        given = [one for one in arrivals if isinstance(one, Arrival)]
        processing.process(fleet, given, now, float(k))
        fleet.log.take_pending()
        if k % 60 == 59:
            processing.checkpoint_of(mill)
        assembly: AssemblyState = mill.state.assembly
        if len(assembly.open_samples) > 2 or len(mill.rows) > 60 or len(fleet.log.limit.seen) > 20:
            raise AssertionError(f"grows: {len(assembly.open_samples)} {len(mill.rows)}")
        yield (
            mill.state.latest.number,
            mill.state.latest.time,
            *mill.state.latest.displacement,
        )


def check(name: str, model: LoadedModel, count: int, seed: int) -> dict[str, Any]:
    """Return what a door made of its damaged readings: whether estimates differ, and the growth."""
    wells = list(estimates(DOORS[name], model, count, seed, damaged=False))
    tracemalloc.start()
    damaged, early = [], 0
    for k, one in enumerate(estimates(DOORS[name], model, count, seed, damaged=True)):
        damaged.append(one)
        if k == count // 2:
            early = tracemalloc.get_traced_memory()[0]
    late = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    # The estimates that are compared are kept, too.
    own = sys.getsizeof(damaged[0]) + 6 * 32
    grown = max(0, late - early - (count - count // 2) * own)
    return {"door": name, "equal": wells == damaged, "grown_kb": round(grown / 1024.0, 1)}


def main() -> None:
    """Run it and print what was found as JSON; exit code 1 if anything failed."""
    from thermojoint.live.loaded_models import load_model
    from thermojoint.live.settings import ModelSection

    parser = options_of(__doc__)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    section = ModelSection(file=given.model.absolute())
    model = load_model(section, Path("/nonexistent"))
    found = [check(name, model, given.count, given.seed) for name in DOORS]
    print(json.dumps({"count": given.count, "interfaces": found}, indent=2))
    sys.exit(not all(one["equal"] and one["grown_kb"] < 512.0 for one in found))


if __name__ == "__main__":
    main()
