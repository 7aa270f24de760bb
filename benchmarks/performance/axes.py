"""Machines that move: a map of the working volume, a step, and the set-up of a long guide.

All in processor time, as ratios to what stands still or to the plain method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.performance.timing import Row, paired, seconds
from benchmarks.study import case_data, case_file
from fesim.axes.axis import Axis, cold_drives
from fesim.axes.guideway import Place
from fesim.axes.machine import MovingMachine
from fesim.axes.mapping import seen_from
from fesim.axes.march import march_moving, march_staggered
from fesim.axes.setup import MovingSetup, axis_inputs, set_up_axes
from fesim.case.history import History
from fesim.case.schema import Case, case_from_data, read_case, step_count
from fesim.march.machine import State, Step
from fesim.march.settling import displaced, initial_state, settle_along
from fesim.march.stepping import march_along, plainly_staggered, staggered
from fesim.march.track import Track
from fesim.one_thread import one_thread
from fesim.setup.loads import march_inputs
from fesim.setup.machine import set_up
from meshes.box_grid import Box, box_mesh, put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.structures import IRON, material_section

REPEATS = 5
#: Points along each axis, off the aligned ones; of every so many the plain method settles one.
POINTS, EVERY = 10, 5
#: The guide and the table's feet, m: length, depth and width; length and width of a foot, and where
#: the feet begin; heights of feet and plate; mesh size; stations, mm.
GUIDE, FOOT, PLATE, SIZE, STATION = (1.0, 0.04, 0.08), 0.04, 0.24, 0.02, 10.0
FEET = [(x, z) for x in (0.0, PLATE - FOOT) for z in (0.0, FOOT)]
FOOT_HEIGHT, HEIGHT = 0.02, 0.05


def rows() -> Iterator[Row]:
    """Yield the map, the step and the set-up, on one thread as `simulate` marches."""
    with one_thread():
        case = read_case(case_file("three_axes"))
        ready = set_up_axes(case)
        last = marched(case, ready)
        yield from map_rows(ready, last)
        yield step_row("moving-step", "three_axes")
        yield step_row("moving-step-knee", "moving_knee")
        yield set_up_row()


def standing_still(name: str) -> Case:
    """Return a shipped machine as it is meshed, without axes: as many contact elements."""
    data = case_data(name)
    del data["axes"]
    data.pop("volume", None)
    for joint in data["joints"].values():
        del joint["axis"], joint["running_friction_coefficient"]
    return case_from_data(data, f"{name}.toml", case_file(name).parent)


#: From a machine with axes, inputs and a state to the steps.
March = Callable[[MovingMachine, Sequence[Axis], Array, State], Iterator[Track]]


def marched(case: Case, ready: MovingSetup, march: March = march_staggered) -> Step:
    """Return the last step of a case."""
    inputs = axis_inputs(case).at(_ends(case))
    start = replace(initial_state(ready.moving.machine), drive=cold_drives(ready.axes))
    *_, track = march(ready.moving, ready.axes, inputs, start)
    return track.step(-1)


def plainly(
    moving: MovingMachine, axes: Sequence[Axis], inputs: Array, start: State
) -> Iterator[Track]:
    """March without machine code for the whole step."""
    return march_moving(moving, axes, inputs, plainly_staggered, start)


def restless(case: Case, ready: MovingSetup) -> MovingSetup:
    """Return the machine where every step of a case ends at a place of its own."""
    rng, times = np.random.default_rng(6), np.concatenate([[0.0], _ends(case)])
    axes = [
        replace(axis, course=History(times, rng.uniform(at[0], at[-1], times.size)))
        for axis, at in zip(ready.axes, _aligned(ready.moving), strict=True)
    ]
    return replace(ready, axes=tuple(axes))


def _ends(case: Case) -> Array:
    return case.march.step_s * np.arange(1.0, step_count(case.march) + 1.0)


def one_by_one(moving: MovingMachine, step: Step, places: list[Place]) -> Array:
    """Displacements at places by the plain method, one after the other."""
    alone = moving.guideway.elastic.alone(step.state.temperature)
    there = replace(step.state, change=np.zeros_like(step.state.change))
    found = []
    for at in places:
        free = moving.guideway.free_at(at, alone)
        machine = replace(moving.machine, contact=moving.settling(at))
        settled, _ = settle_along(machine.contact, there, free[: there.gap.size])
        found.append(displaced(machine, free, settled, step.inputs)[1])
    return np.array(found)


def map_rows(ready: MovingSetup, step: Step) -> Iterator[Row]:
    """Yield the rows of a map of one thermal state: the first one, and every other."""
    moving = ready.moving
    lines = [np.linspace(at[0], at[-1], POINTS + 2)[1:-1] for at in _aligned(moving)]
    places = [tuple(at) for at in np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)]
    some = places[::EVERY]
    seen_from(moving, step, places[::50])  # compiled, and few tied
    first = seconds(lambda: seen_from(moving, step, places), process_time)
    seen = seen_from(moving, step, places)
    off = float(np.abs(seen.displacement[::EVERY] - one_by_one(moving, step, some)).max())
    ours, other, ratio = paired(
        lambda: seen_from(moving, step, places),
        lambda: one_by_one(moving, step, some),
        REPEATS,
        process_time,
    )
    what = (
        f"{len(places)} places of three_axes.toml, between the stations of all axes, "
        f"{moving.machine.contact.count} contact elements; largest gap residual "
        f"{seen.residual.max():.1e} m, displacements differ by {off:.1e} m; every "
        f"{EVERY}th place by the plain method, scaled; processor time"
    )
    yield Row("map-1000", ours, EVERY * other, EVERY * ratio, "s", f"{what}, median of {REPEATS}")
    tied = len(places_around(moving, places))
    yield Row(
        "map-1000-first",
        first,
        EVERY * other,
        EVERY * other / first,
        "s",
        f"the same where the {tied} combinations of aligned positions around are still to be tied, "
        "but for those of every 50th place; once",
    )


def _aligned(moving: MovingMachine) -> tuple[Array, ...]:
    return moving.guideway.stations.positions


def places_around(moving: MovingMachine, places: list[Place]) -> set[tuple[int, ...]]:
    """Combinations of aligned positions around places."""
    stations = moving.guideway.stations
    return {corner for at in places for corner, _ in stations.corners(at)}


def step_row(row: str, name: str) -> Row:
    """Return the row of a step of a shipped machine, against the one that stands."""
    case, fixed = read_case(case_file(name)), standing_still(name)
    ready, setup, ends = set_up_axes(case), set_up(fixed), _ends(case)
    marched(case, ready)  # compiled, and combinations are tied
    inputs, start = march_inputs(fixed).at(ends), initial_state(setup.machine)

    def stands(advance: Any = staggered) -> object:
        return list(march_along(setup.machine, inputs, advance, start))

    stands()  # compiled
    ours, other, ratio = paired(lambda: marched(case, ready), stands, REPEATS, process_time)
    steps, machine = 1e3 / len(ends), ready.moving.machine
    elsewhere = restless(case, ready)
    first, again = (seconds(lambda: marched(case, elsewhere), process_time) for _ in range(2))
    slowly = seconds(lambda: marched(case, elsewhere, plainly), process_time)
    plain = steps * seconds(lambda: marched(case, ready, plainly), process_time)
    without = steps * seconds(lambda: stands(plainly_staggered), process_time)
    return Row(
        row,
        steps * ours,
        steps * other,
        ratio,
        "ms",
        f"{name}.toml, {len(ends)} steps without what is asked about elsewhere, "
        f"{machine.contact.count} contact elements and {machine.thermal.inputs.shape[0]} modes; "
        f"the machine that stands has {setup.machine.thermal.inputs.shape[0]} modes; without "
        f"machine code for the whole march {plain:.2g} ms, and {without:.2g} ms where it stands; "
        f"where every step ends at a place of its own {steps * again:.2g} ms, {steps * first:.2g} "
        f"ms while combinations are still to be tied, and plainly {steps * slowly:.2g} ms; "
        f"processor time, median of {REPEATS}",
    )


def guide_and_table() -> Structure:
    """Return a guide of 1 m and a table on four feet in its middle."""
    length, depth, width = GUIDE
    x0 = 0.5 * (length - PLATE)
    guide = box_mesh([Box((0.0, -depth, 0.0), (length, 0.0, width))], (), ((), (), ()), SIZE)
    feet = [Box((x0 + x, 0.0, z), (x0 + x + FOOT, FOOT_HEIGHT, z + FOOT)) for x, z in FEET]
    plate = Box((x0, FOOT_HEIGHT, 0.0), (x0 + PLATE, HEIGHT, width))
    table = box_mesh([*feet, plate], (), ((), (), ()), SIZE)
    mesh, cells = put_side_by_side([guide, table])
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of_guide = mesh.f2t[0, facets] < cells[0].size
    top = of_guide & (np.abs(y) < 1e-9)
    surfaces = {"top": facets[top], "under": facets[of_guide & (y < 1e-9 - depth)]}
    for k, (own_x, own_z) in enumerate(FEET):
        under = ~of_guide & (np.abs(y) < 1e-9) & (x > x0 + own_x) & (x < x0 + own_x + FOOT)
        surfaces[f"foot{k}"] = facets[under & (z > own_z) & (z < own_z + FOOT)]
    surfaces["end"] = facets[~of_guide & (x < x0 + 1e-9) & (y > FOOT_HEIGHT)]
    surfaces["plate"] = facets[~of_guide & (y > HEIGHT - 1e-9)]
    return Structure(mesh, dict(zip(("guide", "table"), cells, strict=True)), surfaces)


def guide_data(mesh: str) -> dict[str, Any]:
    """Return the case of the guide and its table, which stands; four contact elements a foot."""
    joint = {
        "side_b": "top",
        "preload_MPa": 2.0,
        "along": 2,
        "across": 2,
        "roughness_um": 1.25,
        "asperity_slope": 0.14,
        "hardness_GPa": 1.961,
        "friction_coefficient": 0.5,
        "conductance": {"law": "cmy-1969"},
    }
    return {
        "title": "table on a guide",
        "structure": {"kind": "mesh", "file": mesh},
        "materials": {"iron": material_section(IRON)},
        "bodies": {"guide": "iron", "table": "iron"},
        "joints": {f"foot{k}": joint | {"side_a": f"foot{k}"} for k in range(len(FEET))},
        "supports": {
            "fixed": ["under"],
            "springs": {"end": {"stiffness_N_um": [50.0, 0.0, 0.0]}},
        },
        "sources": {"heat": {"surface": "plate", "reference_power_W": 40.0, "reading": "total"}},
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": 20.0, "duration_min": 5.0},
        "displacement": {"point": "tool", "relative_to": "below"},
        "probes": {
            "tool": {"position_mm": [500.0, 50.0, 40.0], "body": "table"},
            "below": {"position_mm": [500.0, -20.0, 40.0], "body": "guide"},
        },
    }


def guide_cases(folder: Path) -> tuple[Case, Case]:
    """Return the table on its axis, and as it stands."""
    write_structure(guide_and_table(), folder / "guide.vtu")
    data = guide_data("guide.vtu")
    reach = 500.0 * (GUIDE[0] - PLATE)
    axis = {
        "bodies": ["table"],
        "direction": [1.0, 0.0, 0.0],
        "stroke_mm": [-reach, reach],
        "station_mm": STATION,
        "position_mm": 0.0,
    }
    joints = {name: joint | {"axis": "x"} for name, joint in data["joints"].items()}
    riding = data | {"axes": {"x": axis}, "joints": joints}
    return tuple(case_from_data(one, "guide", folder) for one in (riding, data))  # type: ignore[return-value]


def set_up_row() -> Row:
    """Return the row of the set-up of a long guide, against that at one position."""
    with temporary_folder() as folder:
        riding, stands = guide_cases(folder)
        ready, setup = set_up_axes(riding), set_up(stands)
        both = lambda: set_up_axes(riding), lambda: set_up(stands)
        ours, other, ratio = paired(*both, 3, process_time)
    stations, modes = ready.moving.guideway.stations, len(ready.moving.machine.thermal.inputs)
    return Row(
        "moving-set-up",
        ours,
        other,
        ratio,
        "s",
        f"a guide of 1 m, stations of {STATION:g} mm: {len(stations.positions[0])} aligned "
        f"positions, {stations.size - stations.count} stations under four pads of four contact "
        f"elements, {setup.spaces.displacement_size} unknowns, {modes} modes; the "
        "other side is one position; processor time, median of 3",
    )
