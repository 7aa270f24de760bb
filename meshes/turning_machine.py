"""A small turning machine of boxes: a saddle that moves along z, and a cross slide on it along x.

z runs along the spindle, x across, y up. The bed carries the headstock with its spindle, chuck and
workpiece, one body; the cross slide carries the tool.
"""

from __future__ import annotations

from meshes.box_grid import Box
from meshes.box_machine import BoxMachine

TURNING_MACHINE = BoxMachine(
    bodies={
        "bed": (
            Box((0.0, -0.15, 0.0), (0.4, 0.0, 0.9)),
            Box((0.05, 0.0, 0.0), (0.25, 0.3, 0.2)),
            Box((0.1, 0.1, 0.2), (0.2, 0.2, 0.35)),
        ),
        "saddle": (Box((0.0, 0.0, 0.5), (0.4, 0.1, 0.7)),),
        "slide": (Box((0.2, 0.1, 0.5), (0.4, 0.2, 0.7)),),
    },
    moved={"bed": (0, 0, 0), "saddle": (0, 0, 1), "slide": (1, 0, 1)},
    faces={
        "bed_top": ("bed", 1, 0.0),
        "bed_foot": ("bed", 1, -0.15),
        "bed_end": ("bed", 2, 0.9),
        "headstock_front": ("bed", 2, 0.2),
        "headstock_back": ("bed", 2, 0.0),
        "workpiece_front": ("bed", 2, 0.35),
        "saddle_foot": ("saddle", 1, 0.0),
        "saddle_top": ("saddle", 1, 0.1),
        "saddle_back": ("saddle", 2, 0.7),
        "saddle_side": ("saddle", 0, 0.4),
        "slide_foot": ("slide", 1, 0.1),
        "slide_side": ("slide", 0, 0.4),
    },
    covered=("bed_top", "saddle_foot", "saddle_top", "slide_foot"),
)
