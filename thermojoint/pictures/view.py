"""Pictures and films of one case or one response."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fesim.case.schema import Case, first_step_at, read_case, step_count
from fesim.march.machine import Step
from fesim.setup.loads import source_power, thermal_inputs
from fesim.setup.machine import Setup, set_up
from fesim.setup.structure import build_structure, measured_points
from fesim.simulate import at_rest, case_in, simulate
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import read_response
from thermojoint.console import Report, warn
from thermojoint.pictures.camera import Vector
from thermojoint.pictures.field_scenes import (
    Fields,
    Stage,
    cut_panel,
    deformed_panel,
    exaggeration,
    fields_at,
    largest_displacement,
    make_stage,
    outside_panel,
    pressure_panel,
)
from thermojoint.pictures.figures import (
    check_format,
    check_png,
    pressure_figure,
    response_figure,
    write_figure,
)
from thermojoint.pictures.moving import moving_scenes, volume_figure
from thermojoint.pictures.scenes import (
    Marker,
    Panel,
    Scene,
    curves_of,
    in_minutes,
    mirror_of,
    probe_position,
    up_direction,
)
from thermojoint.pictures.show import Show, Up
from thermojoint.pictures.structure_scene import structure_scene, surfaces_scene
from thermojoint.plausibility import of_case

if TYPE_CHECKING:
    import xarray as xr

CURVES = {Show.curves: response_figure, Show.pressures: pressure_figure}
FIELDS = (Show.temperature, Show.deformation, Show.pressure)
#: Default number of frames of a film: ten seconds.
FRAMES = 120


def draw(source: Path, show: Show | None, out: Path, report: Report, up: Up | None = None) -> None:
    """Draw a case (TOML) or a response (.nc) into a PNG; curves also into an SVG or PDF.

    Curves are drawn from the response; fields at the end of the run require another simulation,
    since a response contains only its probes. The default is to show the structure of a case, and a
    response's curves; `up`, not for curves, is by default the direction away from the supports.

    Raises
    ------
    InputError
        The source is unusable, `up` is given for curves, fields are requested for a response
        without its case or that continues a saved state, there are no joints with a pressure to
        show, or `out` has another format.
    """
    from_case = source.suffix != ".nc"
    show = show or (Show.structure if from_case else Show.curves)
    flat = show in (*CURVES, Show.volume)
    (check_format if flat else check_png)(out)
    if flat and up is not None:
        raise InputError(f"--up {up}: --show {show} has no direction; leave it out")
    response = None if from_case else read_response(source)
    if show in CURVES and response is not None:
        write_figure(CURVES[show](response), out)
        return
    only_curves = "so only its curves can be drawn; use --show curves"
    case = read_case(source) if response is None else case_in(response, str(source), only_curves)
    warn(of_case(case, str(source)))
    if show is Show.volume and case.volume is None:
        raise InputError(f"{source}: it asks about no volume; add [volume]")
    if show is Show.volume or (case.axes and show in CURVES):
        marching = partial(report, "marching")
        found = response if response is not None else simulate(case, progress=marching).response
        write_figure(CURVES[show](found) if show in CURVES else volume_figure(found, case), out)
        return
    # Here, not above: mistakes in a case are reported before the drawing libraries are loaded.
    from thermojoint.pictures.stills import write_pictures

    if show is Show.structure:
        structure = build_structure(case)
        write_pictures({out: whole_structure(case, structure, up=up)})
        return
    if response is not None:
        _check_from_rest(source, response)
    _check_joints(source, case, show)
    if case.axes:
        _check_moving(show)
        _, end = moving_scenes(case, report, 2, _upwards(case, build_structure(case), up))
        write_pictures({out: end})
        return
    setup, result, last = run_to_end(case, report)
    if show in CURVES:
        write_figure(CURVES[show](result), out)
    else:
        write_pictures({out: field_scene(show, case, setup, last, up)})


def draw_film(
    source: Path,
    show: Show | None,
    out: Path,
    report: Report,
    count: int | None = None,
    up: Up | None = None,
) -> None:
    """Simulate a case, or the case of a response, and write its fields as a film (MP4, GIF).

    `show` is one of `FIELDS`; default all fields of the case, side by side. `count` frames, by
    default `FRAMES`, are evenly spaced in time from rest to the end; at most one per step.

    Raises
    ------
    InputError
        As `draw`; or `show` is not a field, or the extra 'view' is missing.
    """
    if show is not None and show not in FIELDS:
        raise InputError(f"--show {show}: a film shows {', '.join(FIELDS)}; give one, or none")
    from thermojoint.pictures.film import check_film, write_film

    check_film(out)
    if source.suffix == ".nc":
        response = read_response(source)
        case = case_in(response, str(source), "so there can be no film of it; give its case")
        _check_from_rest(source, response)
    else:
        case = read_case(source)
    if case.displacement is None:
        raise InputError(
            f"{source}: heat alone, so no film; use --show {Show.temperature} without --film, or "
            "add [displacement]"
        )
    if show is not None:
        _check_joints(source, case, show)
    if case.axes:
        _check_moving(show or Show.temperature)
        upwards = _upwards(case, build_structure(case), up)
        moving = moving_scenes(case, report, count or FRAMES, upwards)
        write_film(moving, out, partial(report, "drawing"))
        return
    shows = (show,) if show else FIELDS if case.joints else FIELDS[:2]
    scenes = film_scenes(shows, case, report, count or FRAMES, up)
    write_film(scenes, out, partial(report, "drawing"))


def _check_from_rest(source: Path, response: xr.Dataset) -> None:
    """Refuse a response that continues a saved state: its case would be simulated without it."""
    if float(response["time"][0]) > 0.0:
        raise InputError(
            f"{source}: continues a saved state, which it does not contain, so its fields cannot "
            "be drawn; give the case of the whole run, or use --show curves"
        )


def _check_joints(source: Path, case: Case, show: Show) -> None:
    if case.displacement is None and show in (Show.deformation, Show.pressure, Show.pressures):
        raise InputError(
            f"{source}: heat alone, so no {show}; use --show {Show.temperature}, or add "
            "[displacement]"
        )
    if show in (Show.pressure, Show.pressures) and not case.joints:
        raise InputError(
            f"{source}: no joints, so no contact pressure; use --show {Show.temperature}"
        )


def _check_moving(show: Show) -> None:
    if show is not Show.temperature:
        raise InputError(f"--show {show}: of a machine that moves, --show temperature is drawn")


def run_to_end(
    case: Case, report: Report, setup: Setup | None = None
) -> tuple[Setup, xr.Dataset, Step]:
    """Simulate a case and return its setup, its response and its last step, fields included."""
    setup = setup or _set_up(case, report)
    last = at_rest(setup.machine, thermal_inputs(case)(0.0))

    def keep(step: Step) -> None:
        nonlocal last
        last = step

    finished = simulate(case, setup=setup, on_step=keep, progress=partial(report, "marching"))
    return setup, finished.response, last


def film_scenes(
    shows: tuple[Show, ...], case: Case, report: Report, count: int, up: Up | None = None
) -> list[Scene]:
    """Simulate a case and return scenes at `count` times from rest to the end.

    There are fewer scenes if the simulation has fewer steps.
    """
    setup = _set_up(case, report)
    stage = _stage(case, setup, up)
    setup.make_field()
    times = np.linspace(0.0, step_count(case.march) * case.march.step_s, max(count, 2))[1:]
    due = {first_step_at(float(time), case.march.step_s) for time in times}
    first = at_rest(setup.machine, thermal_inputs(case)(0.0))
    moments = [fields_at(stage, first, len(case.sources))]

    def keep(step: Step) -> None:
        if step.state.index in due:
            moments.append(fields_at(stage, step, len(case.sources)))

    marched = simulate(case, setup=setup, on_step=keep, progress=partial(report, "marching"))
    curves = curves_of(marched.response, (fields.time for fields in moments))
    factor = exaggeration(stage, max(map(largest_displacement, moments)))
    panels: Mapping[Show, Callable[[Fields], Panel]] = {
        Show.temperature: partial(cut_panel, stage),
        Show.deformation: lambda fields: deformed_panel(stage, fields, factor),
        Show.pressure: partial(pressure_panel, stage),
    }
    return [
        Scene(tuple(panels[show](fields) for show in shows), _caption(case, fields), curve)
        for fields, curve in zip(moments, curves, strict=True)
    ]


def whole_structure(
    case: Case,
    structure: Structure,
    sensors: Mapping[str, Vector] | None = None,
    up: Up | None = None,
) -> Scene:
    """Structure with the points of the displacement and the sensors.

    `sensors` maps roles to positions, m; default the temperature probes of the case.
    """
    at = {name: structure.probes[name].position for name in case.probes}
    points = {name: probe_position(structure, name) for name in measured_points(case)}
    points |= at if sensors is None else dict(sensors)
    heats = [
        f"{name} {source.reference_power_W:g} W"
        + (f" {source.reading}, {source.count} of them" if source.count > 1 else "")
        for name, source in case.sources.items()
    ]
    return structure_scene(
        structure,
        [source.surface for source in case.sources.values() if source.surface is not None],
        [Marker(position, name) for name, position in points.items()],
        _upwards(case, structure, up),
        mirror_of(structure, case.supports.symmetry),
        f"at heat input 1: {', '.join(heats)}" if heats else "no heat source",
    )


def bare_structure(structure: Structure) -> Scene:
    """Structure with its joints and its own points; z is up, as in CAD."""
    points = [Marker(probe.position, name) for name, probe in structure.probes.items()]
    return structure_scene(structure, [], points, up_direction(structure, ()))


def named_surfaces(structure: Structure) -> Scene:
    """Surfaces of a structure with their names, from two sides; z is up, as in CAD."""
    return surfaces_scene(structure, up_direction(structure, ()))


def field_scene(show: Show, case: Case, setup: Setup, step: Step, up: Up | None = None) -> Scene:
    """One of `FIELDS` at one step; the pressure needs a joint."""
    stage = _stage(case, setup, up)
    fields = fields_at(stage, step, len(case.sources))
    panels: tuple[Panel, ...]
    if show is Show.pressure:
        panels = (pressure_panel(stage, fields),)
    elif show is Show.deformation:
        panels = (deformed_panel(stage, fields, exaggeration(stage, largest_displacement(fields))),)
    elif stage.mirror is None:
        panels = (outside_panel(stage, fields),)
    else:
        panels = outside_panel(stage, fields), cut_panel(stage, fields)
    return Scene(panels, _caption(case, fields))


def _set_up(case: Case, report: Report) -> Setup:
    report("setting up", 0, 1)
    setup = set_up(case)
    report("setting up", 1, 1)
    return setup


def _stage(case: Case, setup: Setup, up: Up | None) -> Stage:
    structure = setup.structure
    mirror = mirror_of(structure, case.supports.symmetry)
    return make_stage(setup, _upwards(case, structure, up), mirror)


def _upwards(case: Case, structure: Structure, up: Up | None) -> Vector:
    supports = (*case.supports.fixed, *case.supports.springs)
    return up.vector if up is not None else up_direction(structure, supports)


def _caption(case: Case, fields: Fields) -> str:
    """Time and total heat, relative to the reference and in W."""
    time = in_minutes(fields.time)
    reference = sum(source_power(source) for source in case.sources.values())
    if not reference:
        return f"{time}, no heat source"
    power = float(fields.heat.sum())
    return f"{time}, heat input {power / reference:.3g} ({power:.0f} W)"
