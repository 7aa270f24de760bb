"""The commands `mesh`, `inspect` and `view`: from CAD to a mesh, its contents, pictures."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds
from thermojoint.pictures.show import Show, Up

if TYPE_CHECKING:
    from fesim.case.schema import Case
    from meshes.inspection import Inspection
    from meshes.structure import Structure


def mesh(
    part: Annotated[Path, typer.Argument(help="CAD file: STEP, IGES or BREP.")],
    out: Annotated[Path, typer.Option(help="Mesh file to write (MSH, in m).")],
    size: Annotated[float, typer.Option("--size-mm", help="Largest element edge, mm.")],
    order: Annotated[int, typer.Option(min=1, max=2, help="1, or 2 for curved cells.")] = 1,
    names: Annotated[
        Path | None,
        typer.Option(
            help="TOML: \\[surfaces_mm] with NAME = \\[\\[x, y, z], ...], points on faces; "
            "\\[bodies_mm]; \\[joints]."
        ),
    ] = None,
    draft: Annotated[
        Path | None,
        typer.Option(help="File for --names to start from, to write: every face has a name here."),
    ] = None,
) -> None:
    """Mesh a CAD part with its names; needs Gmsh, the extra 'gmsh'.

    Solids become bodies, faces shared by two solids the two sides of a joint, and faces without a
    name BODY_outer. With --draft, they are face_1, face_2, ... instead.

    Example: [bold]thermojoint mesh part.step --size-mm 10 --out part.msh[/bold]

    Example: [bold]thermojoint mesh part.step --size-mm 10 --draft names.toml --out part.msh[/bold]
    """
    from meshes.cad import NO_NAMES, free_faces, mesh_cad, read_names
    from meshes.exchange import read_structure
    from meshes.inspection import inspect as inspect_structure
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import inspection_report

    outputs = {"--out": (out, file_kinds.MESH), "--draft": (draft, file_kinds.DRAFT)}
    arguments.check_outputs(outputs, [part, names])
    if names and draft:
        raise InputError("--draft: has names for everything; leave out --names")
    arguments.positive("--size-mm", size)
    given = read_names(names) if names else NO_NAMES
    with console.working("meshing"):
        if draft:
            text = inspection_report.names_draft(part.name, *free_faces(part, 1e-3 * size))
            write_text(draft, text)
            given = read_names(draft)
        mesh_cad(part, out, 1e-3 * size, order, given)
        inspection = inspect_structure(read_structure(out))
    inspection_report.show(console.out(), str(out), inspection)
    console.wrote(draft, out)


def inspect(
    source: Annotated[Path, typer.Argument(help="Mesh file, or case file (TOML).")],
    unit: Annotated[
        Literal["m", "cm", "mm", "in"],
        typer.Option(help="Unit of a mesh file's coordinates; a case states its own."),
    ] = "m",
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    faces: Annotated[
        Path | None,
        typer.Option(help="Picture of all surfaces with their names, from two sides (PNG)."),
    ] = None,
    as_json: arguments.Json = None,
    skeleton: Annotated[
        Path | None, typer.Option("--case", help="Case file to start from, to write (TOML).")
    ] = None,
) -> None:
    """Inspect a mesh before a simulation: names, volumes, quality, joints, possible mistakes.

    Example: [bold]thermojoint inspect part.msh[/bold]

    Example: [bold]thermojoint inspect part.msh --unit mm --out part.png --case part.toml[/bold]
    """
    from fesim.case.schema import read_case
    from fesim.setup.parts import check_names
    from fesim.setup.structure import build_structure
    from meshes.exchange import read_structure
    from meshes.inspection import inspect as inspect_structure
    from meshes.units import UNITS
    from thermojoint import console, plausibility
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import inspection_report

    outputs = {
        "--out": (out, file_kinds.PICTURE),
        "--faces": (faces, file_kinds.PICTURE),
        "--json": (as_json, file_kinds.INSPECTION),
        "--case": (skeleton, file_kinds.DRAFT),
    }
    arguments.check_outputs(outputs, [source])
    if pictures := [path for path in (out, faces) if path]:
        from thermojoint.pictures.figures import check_png

        for path in pictures:
            check_png(path)
    case = None
    if source.suffix == ".toml":
        if skeleton:
            raise InputError(f"--case {skeleton}: {source} is a case already; give its mesh file")
        case = read_case(source)
        console.warn(plausibility.of_case(case, str(source)))
        with console.working("inspecting"):
            structure = build_structure(case)
            check_names(case, structure)
            riding = [name for name, joint in case.joints.items() if joint.axis is not None]
            found = inspect_structure(structure, riding)
            inspection = _with_loose_bodies(found, case, structure)
    else:
        with console.working("inspecting"):
            structure = read_structure(source, UNITS[unit])
            inspection = inspect_structure(structure)
    inspection_report.show(console.out(as_json), str(source), inspection)
    arguments.write_json(as_json, asdict(inspection))
    if skeleton:
        write_text(skeleton, inspection_report.case_skeleton(source, skeleton, unit, inspection))
    if pictures:
        from thermojoint.pictures.stills import write_pictures
        from thermojoint.pictures.view import bare_structure, named_surfaces, whole_structure

        scenes = {}
        if out:
            drawn = bare_structure(structure) if case is None else whole_structure(case, structure)
            scenes[out] = drawn
        if faces:
            scenes[faces] = named_surfaces(structure)
        write_pictures(scenes)
    console.wrote(as_json, skeleton, out, faces)


def _with_loose_bodies(inspection: Inspection, case: Case, structure: Structure) -> Inspection:
    """Add a warning about bodies that no support or joint of a case holds."""
    from fesim.setup.constraints import checked_constraints
    from fesim.setup.parts import paired_joints

    try:
        checked_constraints(case, structure, paired_joints(case, structure))
    except InputError as error:
        if str(error) not in inspection.warnings:
            return replace(inspection, warnings=(*inspection.warnings, str(error)))
    return inspection


def view(
    source: Annotated[Path, typer.Argument(help="Case file (TOML) or response (NetCDF).")],
    out: Annotated[
        Path, typer.Option(help="Picture to write (PNG; curves also SVG, PDF), or film (MP4, GIF).")
    ],
    show: Annotated[
        Show | None,
        typer.Option(
            metavar="WHAT",
            help=f"{', '.join(view.value for view in Show)}; default: the structure of a case, a "
            "response's curves, all fields of a film.",
        ),
    ] = None,
    film: Annotated[
        bool, typer.Option("--film", help="A film of the fields over the whole run.")
    ] = False,
    frames: Annotated[
        int | None, typer.Option(min=2, help="Frames of a film, 12 a second; default: 120.")
    ] = None,
    up: Annotated[
        Up | None, typer.Option(help="Axis that points up; default: away from the supports.")
    ] = None,
) -> None:
    """Draw a structure, its curves, or its fields at the end of the run or as a film.

    Temperature, deformation and pressure simulate the case, or the case inside the response.

    Example: [bold]thermojoint view machine.toml --out machine.png[/bold]

    Example: [bold]thermojoint view machine.nc --show deformation --out deformed.png[/bold]

    Example: [bold]thermojoint view machine.toml --film --out machine.mp4[/bold]
    """
    from thermojoint import console
    from thermojoint.pictures.view import draw, draw_film

    arguments.check_outputs({"--out": (out, file_kinds.PICTURE)}, [source])
    if frames is not None and not film:
        raise InputError(f"--frames {frames}: only a film has frames; add --film")
    with console.progress_bars() as report:
        if film:
            draw_film(source, show, out, report, frames, up)
        else:
            draw(source, show, out, report, up)
    console.wrote(out)
