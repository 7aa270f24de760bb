"""The command `inspect`: tables of what is in a mesh, and a case file to start from."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path

from rich.console import Console
from rich.table import Table

from meshes.inspection import Inspection


def as_json(found: Inspection) -> str:
    """Return everything found as JSON, SI units."""
    return json.dumps(dataclasses.asdict(found), indent=2) + "\n"


def show(console: Console, name: str, found: Inspection) -> None:
    """Print what is in the mesh and what looks wrong."""
    size = " x ".join(f"{1e3 * length:.4g}" for length in found.extent)
    console.print(f"{name}: {found.cells} {found.kind}, {found.nodes} nodes, {size} mm")
    quality = ", ".join(f"{what} {value:.2f}" for what, value in found.quality.items())
    at = ", ".join(f"{1e3 * x:.4g}" for x in found.worst_cell)
    console.print(f"quality of the cells (1 is best): {quality}; worst at ({at}) mm")
    for table in (_bodies(found), _surfaces(found), _joints(found), _probes(found)):
        if table.row_count:
            console.print(table)
    if found.unnamed_area > 0.0:
        console.print(
            f"{1e4 * found.unnamed_area:.4g} cm2 of the boundary have no name: nothing convects "
            "there"
        )
    for warning in found.warnings:
        console.print(f"warning: {warning}", style="yellow")
    if not found.warnings:
        console.print("nothing looks wrong")


def case_skeleton(mesh: Path, case: Path, unit: str, found: Inspection) -> str:
    """Return the text of a file `case` that names everything in `mesh`, to be completed.

    A case file names other files as they are seen from its own folder.
    """
    seen = os.path.relpath(mesh.parent.resolve() / mesh.name, case.parent.resolve())
    sides = {side for name in found.joints for side in (f"{name}.a", f"{name}.b")}
    free = [name for name in found.surfaces if name not in sides]
    place = next(iter(found.probes), None)
    lines = [
        'title = "..."',
        "",
        "[structure]",
        'kind = "mesh"',
        f"file = {_text(Path(seen).as_posix())}",
        *([f'unit = "{unit}"'] if unit != "m" else []),
        "",
        "[materials.cast_iron]",
        "conductivity_W_mK = 47.0",
        "density_kg_m3 = 7200.0",
        "heat_capacity_J_kgK = 500.0",
        "youngs_modulus_GPa = 104.0",
        "poisson_ratio = 0.27",
        "expansion_1_K = 13.7e-6",
        "",
        "[bodies]",
        *(f'{_key(name)} = "cast_iron"' for name in found.bodies),
        *(
            line
            for name in found.joints
            for line in ("", f"[joints.{_key(name)}]", "preload_MPa = 4.41", "along = 9")
        ),
        *([] if found.joints else ["", "[joints]"]),
        "",
        "[supports]",
        f"fixed = []                # one of: {', '.join(free)}",
        "",
        "[convection_W_m2K]",
        *(f"{_key(name)} = 6.0" for name in free),
        "",
        "[sources.heat]",
        f'surface = "..."           # one of: {", ".join(free)}; or body = "..."',
        "reference_power_W = 100.0",
        "",
        "[heat_input]",
        'kind = "step"',
        "level = 1.0",
        "",
        "[displacement]",
        f"point = {_text(place or 'P')}",
        "",
        f"[probes.{_key('P')}]",
        "position_mm = [0.0, 0.0, 0.0]",
        "",
    ]
    return "\n".join(lines)


def _key(name: str) -> str:
    """Return a name as a TOML key."""
    bare = name.replace("_", "").replace("-", "")
    return name if bare.isascii() and bare.isalnum() else _text(name)


def _text(value: str) -> str:
    """Return a TOML string: escaped as in JSON, but for the surrogate pairs that TOML refuses."""
    return json.dumps(value, ensure_ascii=False)


def _bodies(found: Inspection) -> Table:
    table = Table("body", "cells", "volume, cm3", "extent, mm")
    for name, body in found.bodies.items():
        extent = " x ".join(f"{1e3 * length:.4g}" for length in body.extent)
        table.add_row(name, str(body.cells), f"{1e6 * body.volume:.4g}", extent)
    return table


def _surfaces(found: Inspection) -> Table:
    table = Table("surface", "facets", "area, cm2", "mean normal", "of body")
    for name, surface in found.surfaces.items():
        normal = ", ".join(f"{x:.2f}" for x in surface.normal)
        table.add_row(
            name,
            str(surface.facets),
            f"{1e4 * surface.area:.4g}",
            normal,
            ", ".join(surface.bodies),
        )
    return table


def _joints(found: Inspection) -> Table:
    table = Table(
        "joint",
        "side a, cm2",
        "side b, cm2",
        "shared, cm2",
        "gap, mm",
        "angle, °",
        "normals",
        "meshes",
    )
    for name, joint in found.joints.items():
        table.add_row(
            name,
            *(f"{1e4 * area:.4g}" for area in (joint.area_a, joint.area_b, joint.overlap)),
            f"{1e3 * joint.gap[0]:.3g} to {1e3 * joint.gap[1]:.3g}",
            f"{joint.misalignment:.1f}",
            str(joint.parts),
            "match" if joint.matching else "do not match",
        )
    return table


def _probes(found: Inspection) -> Table:
    table = Table("point", "position, mm", "body")
    for name, (position, body) in found.probes.items():
        place = ", ".join(f"{1e3 * x:.4g}" for x in position)
        table.add_row(name, place, body or "")
    return table
