"""The command `inspect`: tables of a mesh's contents, and a case file to start from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from meshes.inspection import Inspection
from thermojoint.artefacts.settings.toml import as_key, as_text

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


#: Lines of a draft for each joint, to be edited.
_JOINT = (
    "preload_MPa = 1.0         # pressure at the start",
    "# along = 9               # contact elements along its longer side: 5 to 15 by its shape",
    "# across = 3              # and along its shorter side: 5",
    "roughness_um = 1.0        # ground surfaces; turned or milled ones have more",
    "asperity_slope = 0.15",
    "hardness_GPa = 2.0        # of the softer side: 0.0098 x its hardness HB",
    "friction_coefficient = 0.2",
    "# A joint that starts open, with air in it, in place of the preload:",
    "# preload_MPa = 0.0",
    "# initial_opening_um = 20.0",
    "# reference_pressure_MPa = 1.0",
    "# gap = { gas_conductivity_W_mK = 0.026, temperature_jump_um = 0.4 }",
    '# conductance = { law = "fixed", value_W_m2K = 5000.0 }',
    '# conductance = { law = "table", file = "conductance.csv" }',
)


def case_skeleton(mesh: Path, case: Path, unit: str, inspection: Inspection) -> str:
    """Return the text of a file `case` with all names of `mesh`, to be completed.

    Files named in a case are relative to its folder.
    """
    relative = os.path.relpath(mesh.parent.resolve() / mesh.name, case.parent.resolve())
    sides = {side for name in inspection.joints for side in (f"{name}.a", f"{name}.b")}
    free = [name for name in inspection.surfaces if name not in sides]
    place = next(iter(inspection.probes), None)
    lines = [
        'title = "..."',
        "",
        "[structure]",
        'kind = "mesh"',
        f"file = {as_text(Path(relative).as_posix())}",
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
        *(f'{as_key(name)} = "cast_iron"' for name in inspection.bodies),
        *(line for name in inspection.joints for line in ("", f"[joints.{as_key(name)}]", *_JOINT)),
        *([] if inspection.joints else ["", "[joints]"]),
        "",
        "# A rigid wall before a surface, for a joint to press on; give it a material in [bodies].",
        "# [walls.wall]",
        f'# faces = "..."          # one of: {", ".join(free)}',
        "",
        "[supports]",
        f"fixed = []                # one of: {', '.join(free)}",
        "",
        "[convection_W_m2K]",
        *(f"{as_key(name)} = 6.0" for name in free),
        "",
        "[sources.heat]",
        f'surface = "..."           # one of: {", ".join(free)}; or body = "..."',
        "reference_power_W = 100.0",
        '# profile = { expression = "exp(-z_mm / 20)" } # spreads the same heat unevenly',
        "",
        '# Warm at the start; or expression_K = "20 - 0.05 * z_mm", or the file of a table.',
        "# [initial_temperature]",
        "# rise_K = 0.0",
        "",
        '# What depends on temperature needs thermal = "full" in [march]:',
        "# [radiation]",
        f"# {as_key(next(iter(free), 'SURFACE'))} = {{ emissivity = 0.8, ambient_degC = 20.0 }}",
        "# [cavities.air]         # enclosed",
        f"# surfaces = [{as_text(next(iter(free), 'SURFACE'))}]",
        "# film_W_m2K = 3.0",
        "# [materials.cast_iron.conductivity_factor] # or expansion_factor",
        "# rise_K = [0.0, 100.0]",
        "# factor = [1.0, 0.95]",
        "",
        "# Forces: a surface with force_N or pressure_MPa, or acceleration_m_s2 of bodies.",
        "# [loads.gravity]",
        "# acceleration_m_s2 = [0.0, 0.0, -9.81]",
        "",
        "# A bolt: each end a surface, or a disc around a point of a body.",
        "# [bolts.b1]",
        '# head = { surface = "..." }',
        '# thread = { position_mm = [0.0, 0.0, 0.0], diameter_mm = 12.0, body = "..." }',
        "# force_kN = 20.0          # after all bolts are tight",
        "# diameter_mm = 12.0",
        '# material = "cast_iron"',
        "",
        "[heat_input]",
        'kind = "step"',
        "level = 1.0",
        "",
        "[march]",
        "step_s = 5.0",
        "duration_min = 30.0",
        "",
        "[displacement]",
        f"point = {as_text(place or 'P')}",
        "",
        f"[probes.{as_key('P')}]",
        "position_mm = [0.0, 0.0, 0.0]",
        "",
        "# What supports and joints bear, and stresses at probes, in the response:",
        "# [output]",
        "# forces = true",
        f"# stress_probes = [{as_text('P')}]",
        "",
    ]
    return "\n".join(lines)


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
