"""A small machine of boxes with three axes: a column, a ram on it, and a table.

The column moves along x on the bed and carries the ram, which moves along y; the table moves along
z on the bed. x runs across, y up, and z from the column to the table.
"""

from __future__ import annotations

from collections.abc import Sequence

from meshes.box_grid import Box
from meshes.box_machine import BoxMachine, meshed
from meshes.structure import Structure

THREE_AXES = BoxMachine(
    bodies={
        "bed": (Box((0.0, -0.1, 0.0), (0.8, 0.0, 0.3)), Box((0.2, -0.1, 0.3), (0.6, 0.0, 0.9))),
        "column": (Box((0.3, 0.0, 0.1), (0.5, 0.8, 0.3)),),
        "ram": (Box((0.3, 0.3, 0.3), (0.5, 0.5, 0.5)),),
        "table": (Box((0.3, 0.0, 0.5), (0.5, 0.1, 0.7)),),
    },
    moved={"bed": (0, 0, 0), "column": (1, 0, 0), "ram": (1, 1, 0), "table": (0, 0, 1)},
    faces={
        "column_foot": ("column", 1, 0.0),
        "column_front": ("column", 2, 0.3),
        "column_back": ("column", 2, 0.1),
        "column_top": ("column", 1, 0.8),
        "column_side": ("column", 0, 0.3),
        "ram_back": ("ram", 2, 0.3),
        "ram_top": ("ram", 1, 0.5),
        "ram_side": ("ram", 0, 0.3),
        "spindle": ("ram", 2, 0.5),
        "table_foot": ("table", 1, 0.0),
        "table_top": ("table", 1, 0.1),
        "table_back": ("table", 2, 0.5),
        "table_side": ("table", 0, 0.3),
        "bed_top": ("bed", 1, 0.0),
        "bed_foot": ("bed", 1, -0.1),
        "bed_left": ("bed", 0, 0.0),
        "bed_back": ("bed", 2, 0.0),
        "bed_end": ("bed", 2, 0.9),
    },
    covered=("bed_top", "column_foot", "column_front", "ram_back", "table_foot"),
)


def three_axis_machine(size: float, at: Sequence[float] = (0.0, 0.0, 0.0)) -> Structure:
    """Return the machine with elements of `size`, m, at a position of its axes x, y and z, m."""
    return meshed(THREE_AXES, size, at)
