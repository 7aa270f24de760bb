"""The reference machine: a box-type horizontal milling machine (Attia & Fraser, Fig. 6).

x runs from the column to the table, y up, z across; the machine is symmetric about z = width/2.
The paper prints the envelope, the contact strips and the wall thickness; the other dimensions are
assumptions (docs/readings.md) and parameters here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from meshes.box_grid import Box, Refinement, box_mesh, put_side_by_side
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError

_SLACK = 1e-7  # m; facet mid-points are compared with planes


@dataclass(frozen=True)
class MillingMachineDimensions:
    """Every dimension of the machine, in m."""

    #: Outer size of the column along x and y, and of the machine along z.
    column_depth: float = 0.60
    column_height: float = 1.15
    width: float = 0.50
    #: Thickness of all walls.
    wall: float = 0.05
    #: Heights of the faces of the column's internal bracket.
    bracket_bottom: float = 0.75
    bracket_top: float = 0.80
    #: Thickness of the contact strips along x.
    strip_depth: float = 0.05
    #: Distance of a strip from the side of the machine, and its width, along z.
    strip_inset: float = 0.05
    strip_width: float = 0.075
    #: Heights of the ends of the strips; None for those of the table.
    strip_bottom: float | None = None
    strip_top: float | None = None
    #: Heights of the table's faces and its length along x.
    table_bottom: float = 0.35
    table_top: float = 0.75
    table_length: float = 0.80
    #: Start along x, extent along x, and extent along z of the support screw.
    screw_x: float = 1.00
    screw_depth: float = 0.05
    screw_width: float = 0.10
    #: Height of its foot.
    screw_bottom: float = 0.0
    #: Bearing source on the inside of the column's front wall: height of its top edge, size along
    #: y, distance from the side along z, and width along z.
    source_top: float = 0.75
    source_height: float = 0.10
    source_inset: float = 0.05
    source_width: float = 0.10
    #: Height of the spindle nose, point A.
    nose_height: float = 1.05
    #: Distance of point B from the table's column side along x.
    table_point: float = 0.15

    @property
    def strip_ends(self) -> tuple[float, float]:
        """Heights of the ends of the strips, m."""
        low = self.table_bottom if self.strip_bottom is None else self.strip_bottom
        return low, self.table_top if self.strip_top is None else self.strip_top


def box_milling_machine(
    dimensions: MillingMachineDimensions | None = None,
    *,
    element_size: float = 0.05,
    joint_element_size: float | None = None,
    half: bool = True,
    probes: dict[str, Probe] | None = None,
) -> Structure:
    """Build the reference machine.

    Parameters
    ----------
    dimensions : MillingMachineDimensions, optional
        Every length, m.
    element_size : float
        Largest element edge, m.
    joint_element_size : float, optional
        Largest edge in and next to the contact strips, m; default `element_size`.
    half : bool
        Mesh 0 <= z <= width/2 only, with the surface ``symmetry`` at the cut.
    probes : dict of Probe, optional
        Further named points; ``A`` (spindle nose) and ``B`` (table) are always present.

    Returns
    -------
    Structure
        Bodies ``column``, ``table``, ``screw``; surfaces ``exterior``, ``interior``,
        ``column_base``, ``screw_foot``, ``bearings``, ``rear`` (of the column's outside; part of
        the exterior), ``knee.a`` (strips), ``knee.b`` (table) and,
        for the half, ``symmetry``; joint ``knee``.

    Raises
    ------
    InputError
        A dimension is not positive, or the parts do not fit together.
    """
    d = dimensions or MillingMachineDimensions()
    _check_dimensions(d)
    depth = d.width / 2 if half else d.width
    near_joint = _near_joint(d, depth, joint_element_size or element_size)
    column = _column(d, element_size, depth, near_joint)
    table = _table_and_screw(d, element_size, depth, near_joint)
    mesh, (column_cells, table_cells) = put_side_by_side([column, table])
    centres = mesh.p[:, mesh.t].mean(axis=1)
    screw = np.intersect1d(table_cells, np.flatnonzero(centres[1] < d.table_bottom))
    mid = d.width / 2
    own = {
        "A": Probe((d.column_depth, d.nose_height, mid), "column"),
        "B": Probe((d.column_depth + d.strip_depth + d.table_point, d.table_top, mid), "table"),
    }
    return Structure(
        mesh=mesh,
        bodies={"column": column_cells, "table": np.setdiff1d(table_cells, screw), "screw": screw},
        surfaces=_surfaces(mesh, d, column_cells, half),
        joints={"knee": ("knee.a", "knee.b")},
        probes=own | (probes or {}),
        symmetry_factor=2 if half else 1,
    )


def _check_dimensions(d: MillingMachineDimensions) -> None:
    for name, value in vars(d).items():
        if value is None or (name == "screw_bottom" and value == 0.0):
            continue
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"milling machine: {name} is {value} m; give a positive length")
    fits = {
        "bracket": d.wall < d.bracket_bottom < d.bracket_top < d.column_height - d.wall,
        "strips": d.strip_inset + d.strip_width <= d.width / 2
        and d.strip_ends[0] < d.strip_ends[1] <= d.column_height
        and d.strip_ends[0] < d.table_top
        and d.table_bottom < d.strip_ends[1],
        "column": 2 * d.wall < d.column_depth,
        "table": d.table_bottom + 2 * d.wall < d.table_top and 2 * d.wall < d.table_length,
        "screw": d.screw_x + d.screw_depth <= d.column_depth + d.strip_depth + d.table_length
        and d.screw_x >= d.column_depth + d.strip_depth
        and d.screw_width <= d.width
        and d.screw_bottom < d.table_bottom,
        "source": d.wall < d.source_top - d.source_height
        and d.source_top <= d.bracket_bottom
        and d.source_inset >= d.wall
        and d.source_inset + d.source_width <= d.width / 2,
        "nose": d.nose_height <= d.column_height,
        "table_point": d.table_point <= d.table_length,
    }
    for part, fit in fits.items():
        if not fit:
            raise InputError(f"milling machine: the {part} does not fit; check its dimensions")


def _both_sides(d: MillingMachineDimensions, values: list[float], depth: float) -> list[float]:
    """Mirror z-coordinates about the symmetry plane and keep those within `depth`."""
    mirrored = [*values, *(d.width - z for z in values), d.width / 2]
    return [z for z in mirrored if z <= depth + _SLACK]


def _strips(d: MillingMachineDimensions, depth: float) -> list[Box]:
    starts = [d.strip_inset, d.width - d.strip_inset - d.strip_width]
    x, (low, high) = d.column_depth, d.strip_ends
    return [
        Box((x, low, z), (x + d.strip_depth, high, z + d.strip_width)) for z in starts if z < depth
    ]


def _near_joint(d: MillingMachineDimensions, depth: float, size: float) -> list[Refinement]:
    """Refinements in the strips and the walls on both sides of them."""
    return [
        Refinement(
            Box(
                (strip.low[0] - d.wall, strip.low[1], strip.low[2]),
                (strip.high[0] + d.wall, strip.high[1], strip.high[2]),
            ),
            size,
        )
        for strip in _strips(d, depth)
    ]


def _hollow(d: MillingMachineDimensions, depth: float) -> tuple[float, float]:
    """z-range of the cavities: to the symmetry plane in the half model, else to the far wall."""
    return d.wall, d.width - d.wall if depth == d.width else depth


def _column(
    d: MillingMachineDimensions, size: float, depth: float, finer: list[Refinement]
) -> MeshHex:
    low, high = _hollow(d, depth)
    x = (d.wall, d.column_depth - d.wall)
    shell = Box((0.0, 0.0, 0.0), (d.column_depth, d.column_height, depth))
    below = Box((x[0], d.wall, low), (x[1], d.bracket_bottom, high))
    above = Box((x[0], d.bracket_top, low), (x[1], d.column_height - d.wall, high))
    heights = [d.source_top - d.source_height, d.source_top, d.nose_height]
    across = [d.source_inset, d.source_inset + d.source_width]
    breaks = ((), heights, _both_sides(d, across, depth))
    return box_mesh([shell, *_strips(d, depth)], [below, above], breaks, size, finer)


def _table_and_screw(
    d: MillingMachineDimensions, size: float, depth: float, finer: list[Refinement]
) -> MeshHex:
    low, high = _hollow(d, depth)
    x0 = d.column_depth + d.strip_depth
    x1 = x0 + d.table_length
    side = (d.width - d.screw_width) / 2
    shell = Box((x0, d.table_bottom, 0.0), (x1, d.table_top, depth))
    cavity = Box(
        (x0 + d.wall, d.table_bottom + d.wall, low), (x1 - d.wall, d.table_top - d.wall, high)
    )
    screw_z = (side, min(side + d.screw_width, depth))
    screw = Box(
        (d.screw_x, d.screw_bottom, screw_z[0]),
        (d.screw_x + d.screw_depth, d.table_bottom, screw_z[1]),
    )
    across = [d.strip_inset, d.strip_inset + d.strip_width]
    breaks = ([x0 + d.table_point], (), _both_sides(d, across, depth))
    return box_mesh([shell, screw], [cavity], breaks, size, finer)


def _surfaces(
    mesh: MeshHex, d: MillingMachineDimensions, column_cells: NDArray[np.int64], half: bool
) -> dict[str, NDArray[np.int64]]:
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of_column = np.isin(mesh.f2t[0, facets], column_cells)
    joint_x = d.column_depth + d.strip_depth
    end = joint_x + d.table_length

    def at(value: NDArray[np.float64], plane: float) -> NDArray[np.bool_]:
        return np.abs(value - plane) < _SLACK

    def between(value: NDArray[np.float64], low: float, high: float) -> NDArray[np.bool_]:
        return (value > low + _SLACK) & (value < high - _SLACK)

    from_side = np.minimum(z, d.width - z)
    on_strip = between(from_side, d.strip_inset, d.strip_inset + d.strip_width)
    on_strip &= between(y, *d.strip_ends)
    cut = at(z, d.width / 2) if half else np.zeros(facets.size, dtype=bool)
    foot = np.where(of_column, at(y, 0.0), at(y, d.screw_bottom))
    joint = at(x, joint_x) & on_strip
    inside_z = between(z, 0.0, d.width) & ~cut
    in_column = of_column & between(x, 0.0, d.column_depth) & between(y, 0.0, d.column_height)
    in_table = (
        ~of_column & between(x, joint_x, end) & between(y, d.table_bottom, d.table_top) & inside_z
    )
    interior = (in_column & inside_z) | in_table
    source = (
        of_column
        & at(x, d.column_depth - d.wall)
        & between(y, d.source_top - d.source_height, d.source_top)
        & between(from_side, d.source_inset, d.source_inset + d.source_width)
    )
    chosen = {
        "exterior": ~(cut | foot | joint | interior),
        "interior": interior,
        "column_base": of_column & foot,
        "screw_foot": ~of_column & foot,
        "bearings": source,
        "rear": of_column & at(x, 0.0),
        "knee.a": joint & of_column,
        "knee.b": joint & ~of_column,
    } | ({"symmetry": cut} if half else {})
    return {name: facets[mask] for name, mask in chosen.items()}
