"""Pictures of one case or one response."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from artefacts.errors import InputError
from artefacts.response import read_response
from fesim.case import Case, read_case
from fesim.march import Step
from fesim.setup import Setup, build_structure, set_up
from fesim.simulate import at_rest, case_in, simulate
from meshes.structure import Structure
from thermojoint.console import Report
from thermojoint.figures import (
    check_format,
    check_png,
    pressure_figure,
    response_figure,
    write_figure,
)
from thermojoint.scenes import (
    Scene,
    deformed_scene,
    markers,
    mirror_of,
    pressure_scene,
    probe_position,
    structure_scene,
    temperature_scene,
)
from thermojoint.show import Show

if TYPE_CHECKING:
    import xarray as xr

CURVES = {Show.curves: response_figure, Show.pressures: pressure_figure}
FIELDS = (Show.temperature, Show.deformation, Show.pressure)


def draw(source: Path, show: Show | None, out: Path, report: Report) -> None:
    """Draw what a case file or a response holds into `out`.

    Curves are drawn from the response; the fields at the end of the run are simulated again, since
    a response keeps only its probes.

    Parameters
    ----------
    source : Path
        A case (TOML) or a response (.nc).
    show : Show, optional
        Default the structure of a case, and a response's curves.
    out : Path
        PNG; curves also SVG or PDF.
    report : callable
        Progress.

    Raises
    ------
    InputError
        The source is unusable, a response without its case is asked for more than curves, there
        are no joints whose pressure could be shown, or `out` has another format.
    """
    from_case = source.suffix != ".nc"
    show = show or (Show.structure if from_case else Show.curves)
    check = check_format if show in CURVES else check_png
    check(out)
    response = None if from_case else read_response(source)
    if show in CURVES and response is not None:
        write_figure(CURVES[show](response), out)
        return
    only_curves = "so only its curves can be drawn; use --show curves"
    case = read_case(source) if response is None else case_in(response, str(source), only_curves)
    # Here, not above: what is wrong with a case is said before anything can draw.
    from thermojoint.pictures import write_pictures

    if show is Show.structure:
        write_pictures({out: whole_structure(case, build_structure(case))})
        return
    if show in (Show.pressure, Show.pressures) and not case.joints:
        raise InputError(
            f"{source}: no joints, so no contact pressure; use --show {Show.temperature}"
        )
    setup, result, last = run_to_end(case, report)
    if show in CURVES:
        write_figure(CURVES[show](result), out)
    else:
        write_pictures({out: field_scene(show, case, setup, last)})


def run_to_end(
    case: Case, report: Report, setup: Setup | None = None
) -> tuple[Setup, xr.Dataset, Step]:
    """Simulate a case and return its setup, its response and its last step, fields included."""
    if setup is None:
        report("setting up", 0, 1)
        setup = set_up(case)
        report("setting up", 1, 1)
    last = at_rest(setup.machine)

    def keep(step: Step) -> None:
        nonlocal last
        last = step

    finished = simulate(case, setup=setup, on_step=keep, progress=partial(report, "marching"))
    return setup, finished.response, last


def whole_structure(
    case: Case,
    structure: Structure,
    sensors: Mapping[str, tuple[float, float, float]] | None = None,
) -> Scene:
    """Structure with the points of the displacement and the sensors.

    Parameters
    ----------
    case : Case
        Its displacement, source and symmetry are marked.
    structure : Structure
        As built from the case.
    sensors : mapping, optional
        Role to position, m; default the temperature probes that the case names.
    """
    ends = [case.displacement.point, case.displacement.relative_to]
    at = {name: structure.probes[name].position for name in case.probes}
    points = {name: probe_position(structure, name) for name in ends if name is not None}
    points |= at if sensors is None else dict(sensors)
    return structure_scene(
        structure,
        [source.surface for source in case.sources.values() if source.surface is not None],
        markers(points),
        mirror_of(structure, case.supports.symmetry),
    )


def bare_structure(structure: Structure) -> Scene:
    """Structure with its joints and its own points."""
    return structure_scene(
        structure, [], markers({name: probe.position for name, probe in structure.probes.items()})
    )


def field_scene(show: Show, case: Case, setup: Setup, step: Step) -> Scene:
    """One of `FIELDS` at one step; the pressure needs a joint."""
    mirror = mirror_of(setup.structure, case.supports.symmetry)
    if show is Show.pressure:
        return pressure_scene(setup, step.state.pressure, mirror)
    draw_field = deformed_scene if show is Show.deformation else temperature_scene
    return draw_field(setup, step, mirror)
