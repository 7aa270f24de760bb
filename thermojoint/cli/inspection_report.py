"""The command `inspect`: tables of a mesh's contents, and a case file to start from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from meshes.cad import Face
from meshes.inspection import Inspection
from thermojoint.artefacts.settings.toml import as_key, as_text
from thermojoint.artefacts.templates import templates_of

_ANY_WIDTH = 100_000
Row = tuple[str, ...]
#: Names of the columns, and the rows; the first column names the object.
Rows = tuple[Row, list[Row]]


def show(console: Console, name: str, inspection: Inspection) -> None:
    """Print the contents of a mesh and its warnings."""
    size = " x ".join(f"{1e3 * length:.4g}" for length in inspection.extent)
    console.print(
        f"{name}: {inspection.cells} {inspection.kind}, {inspection.nodes} nodes, {size} mm",
        soft_wrap=True,
    )
    quality = ", ".join(f"{what} {value:.2f}" for what, value in inspection.quality.items())
    at = ", ".join(f"{1e3 * x:.4g}" for x in inspection.worst_cell)
    console.print(
        f"quality of the cells (1 is best): {quality}; worst at ({at}) mm", soft_wrap=True
    )
    for header, rows in (
        _bodies(inspection),
        _surfaces(inspection),
        _joints(inspection),
        _probes(inspection),
    ):
        if rows:
            _print(console, header, rows)
    if inspection.unnamed_area > 0.0:
        console.print(
            f"{1e4 * inspection.unnamed_area:.4g} cm2 of the boundary have no name: "
            "nothing convects there"
        )
    for warning in inspection.warnings:
        console.print(f"warning: {warning}", style="yellow", soft_wrap=True)
    if not inspection.warnings:
        console.print("nothing looks wrong")


def case_skeleton(mesh: Path, case: Path, unit: str, inspection: Inspection) -> str:
    """Return the text of a file `case` with all names of `mesh`, to be completed.

    Files named in a case are relative to its folder.
    """
    relative = os.path.relpath(mesh.parent.resolve() / mesh.name, case.parent.resolve())
    sides = {side for name in inspection.joints for side in (f"{name}.a", f"{name}.b")}
    template = templates_of("thermojoint.cli").get_template("draft.toml.j2")
    return template.render(
        file=as_text(Path(relative).as_posix()),
        unit=unit,
        bodies=map(as_key, inspection.bodies),
        joints=[as_key(name) for name in inspection.joints],
        free=[name for name in inspection.surfaces if name not in sides],
        point=as_text(next(iter(inspection.probes), "P")),
        key=as_key,
        text=as_text,
    )


def names_draft(part: str, faces: Sequence[Face], touching: Sequence[tuple[str, str]]) -> str:
    """Return the text of a file of names for every body, joint and face of a part."""
    points = [", ".join(f"{1e3 * x:.6g}" for x in face.point) for face in faces]
    template = templates_of("thermojoint.cli").get_template("names.toml.j2")
    return template.render(
        part=part,
        bodies={face.body: point for face, point in zip(faces, points, strict=True)},
        touching=touching,
        faces=[(face, point) for face, point in zip(faces, points, strict=True)],
        key=as_key,
        text=as_text,
    )


def _print(console: Console, header: Row, rows: Sequence[Row]) -> None:
    """Print a table, or one paragraph per row if it is too wide.

    Names are never cut or folded, so that they can be copied into a case.
    """
    table = Table(*(what.replace(" (", "\n(") for what in header))
    for row in rows:
        table.add_row(*row)
    unlimited = console.options.update(max_width=_ANY_WIDTH)
    if Measurement.get(console, unlimited, table).maximum <= console.width:
        console.print(table)
        return
    for name, *values in rows:
        console.print(f"{header[0]} {name}", soft_wrap=True)
        facts = (f"{what} {value}" for what, value in zip(header[1:], values, strict=True))
        console.print(f"  {'; '.join(facts)}", soft_wrap=True)


def _bodies(inspection: Inspection) -> Rows:
    return ("body", "cells", "volume (cm3)", "extent (mm)"), [
        (
            name,
            str(body.cells),
            f"{1e6 * body.volume:.4g}",
            " x ".join(f"{1e3 * length:.4g}" for length in body.extent),
        )
        for name, body in inspection.bodies.items()
    ]


def _surfaces(inspection: Inspection) -> Rows:
    return ("surface", "facets", "area (cm2)", "mean normal", "of body"), [
        (
            name,
            str(surface.facets),
            f"{1e4 * surface.area:.4g}",
            ", ".join(f"{x:.2f}" for x in surface.normal),
            ", ".join(surface.bodies),
        )
        for name, surface in inspection.surfaces.items()
    ]


def _joints(inspection: Inspection) -> Rows:
    header = (
        *("joint", "side a (cm2)", "side b (cm2)", "shared (cm2)"),
        *("gap (mm)", "angle (°)", "normals", "meshes"),
    )
    return header, [
        (
            name,
            *(f"{1e4 * area:.4g}" for area in (joint.area_a, joint.area_b, joint.overlap)),
            f"{1e3 * joint.gap[0]:.3g} to {1e3 * joint.gap[1]:.3g}",
            f"{joint.misalignment:.1f}",
            str(joint.parts),
            "match" if joint.matching else "do not match",
        )
        for name, joint in inspection.joints.items()
    ]


def _probes(inspection: Inspection) -> Rows:
    return ("point", "position (mm)", "body"), [
        (name, ", ".join(f"{1e3 * x:.4g}" for x in position), body or "")
        for name, (position, body) in inspection.probes.items()
    ]
