"""Commands of structures: from CAD to a mesh, what is in a mesh, pictures."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from artefacts.errors import InputError
from thermojoint import arguments, file_kinds
from thermojoint.show import Show


class Unit(StrEnum):
    """Units of a mesh file."""

    m = "m"
    cm = "cm"
    mm = "mm"
    inch = "in"


def mesh(
    part: Annotated[Path, typer.Argument(help="CAD file: STEP, IGES or BREP.")],
    out: Annotated[Path, typer.Option(help="Mesh file to write (MSH, in m).")],
    size: Annotated[float, typer.Option("--size-mm", help="Largest element edge, mm.")],
    order: Annotated[int, typer.Option(min=1, max=2, help="1, or 2 for curved cells.")] = 1,
    names: Annotated[
        Path | None,
        typer.Option(help="TOML: [surfaces_mm] with NAME = [[x, y, z], ...], points on faces."),
    ] = None,
) -> None:
    """Mesh a CAD part with its names; needs Gmsh, the extra 'gmsh'.

    Solids become bodies, faces of two solids that lie on each other the sides of a joint, faces
    without a name BODY_outer.

    Example: [bold]thermojoint mesh part.step --size-mm 10 --out part.msh[/bold]
    """
    from meshes.cad import mesh_cad, read_names
    from meshes.exchange import read_structure
    from meshes.inspection import inspect as look_over
    from thermojoint import console, inspection_report

    arguments.check_outputs({"--out": (out, file_kinds.MESH)}, [part, names])
    if not 0.0 < size < math.inf:
        raise InputError(f"--size-mm {size:g}: give a positive length")
    mesh_cad(part, out, 1e-3 * size, order, read_names(names) if names else None)
    found = look_over(read_structure(out))
    inspection_report.show(console.out(), str(out), found)
    console.wrote(out)


def inspect(
    source: Annotated[Path, typer.Argument(help="Mesh file, or case file (TOML).")],
    unit: Annotated[
        Unit, typer.Option(help="Unit of a mesh file's coordinates; a case says its own.")
    ] = Unit.m,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    as_json: Annotated[Path | None, typer.Option("--json", help="JSON to write.")] = None,
    skeleton: Annotated[
        Path | None, typer.Option("--case", help="Case file to start from, to write (TOML).")
    ] = None,
) -> None:
    """Look a mesh over before simulating it: names, volumes, quality, joints, what looks wrong.

    Example: [bold]thermojoint inspect part.msh[/bold]

    Example: [bold]thermojoint inspect part.msh --unit mm --out part.png --case part.toml[/bold]
    """
    from artefacts.files import write_text
    from fesim.case import read_case
    from fesim.setup import UNITS, build_structure, check_names
    from meshes.exchange import read_structure
    from meshes.inspection import inspect as look_over
    from thermojoint import console, inspection_report

    outputs = {
        "--out": (out, file_kinds.PICTURE),
        "--json": (as_json, file_kinds.INSPECTION),
        "--case": (skeleton, file_kinds.DRAFT),
    }
    arguments.check_outputs(outputs, [source])
    if out:
        from thermojoint.figures import check_png

        check_png(out)
    if source.suffix == ".toml":
        if skeleton:
            raise InputError(f"--case {skeleton}: {source} is a case already; give its mesh file")
        case = read_case(source)
        structure = build_structure(case)
        check_names(case, structure)
    else:
        structure = read_structure(source, UNITS[unit.value])
    found = look_over(structure)
    inspection_report.show(console.out(), str(source), found)
    if as_json:
        write_text(as_json, inspection_report.as_json(found))
    if skeleton:
        write_text(skeleton, inspection_report.case_skeleton(source, skeleton, unit.value, found))
    if out:
        from thermojoint.pictures import write_pictures
        from thermojoint.view import bare_structure

        write_pictures({out: bare_structure(structure)})
    console.wrote(as_json, skeleton, out)


def view(
    source: Annotated[Path, typer.Argument(help="Case file (TOML) or response (NetCDF).")],
    out: Annotated[Path, typer.Option(help="Picture to write (PNG; curves also SVG, PDF).")],
    show: Annotated[
        Show | None,
        typer.Option(help="What to show; default: the structure of a case, a response's curves."),
    ] = None,
) -> None:
    """Draw a structure, its curves, or its fields at the end of the run.

    Temperature, deformation and pressure simulate the case, or the case inside the response.

    Example: [bold]thermojoint view machine.toml --out machine.png[/bold]

    Example: [bold]thermojoint view machine.nc --show deformation --out deformed.png[/bold]
    """
    from thermojoint import console
    from thermojoint.view import draw

    arguments.check_outputs({"--out": (out, file_kinds.PICTURE)}, [source])
    with console.progress_bars() as report:
        draw(source, show, out, report)
    console.wrote(out)
