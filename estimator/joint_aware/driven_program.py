"""Drives of axes in an exported program: a ball screw or a scale, as `reduced.axis_drive` has them.

A step takes the nominal interval, so that all but the film is constant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from estimator.export.program import Operations, Table
from fesim.axes.positioning import Scale, Screw
from thermojoint.reduced.axis_drive import SHORTEST
from thermojoint.reduced.machine import MovingAxis

#: Terms of the series of phi_1, for decays below one.
TERMS = 18


class Driven(NamedTuple):
    """What a template needs of drives."""

    #: Numbers of each drive.
    drives: list[dict[str, Any]]
    tables: list[Table]
    #: Numbers of the state.
    state: int
    #: Of the drives' step, and of what they add at a place.
    step: Operations
    place: Operations


def driven(axes: Sequence[MovingAxis], step: float) -> Driven:
    """Return what the program of these axes has of their drives; the step is in s."""
    drives, tables = list[dict[str, Any]](), list[Table]()
    for k, axis in enumerate(axes):
        if axis.drive is None or (axis.drive.screw is None and axis.drive.scale is None):
            continue
        own = axis.drive.drive
        tables.append(
            Table(f"carried_{k}", "Displacement per error, per axis.", axis.drive.carried)
        )
        common = {"axis": k, "zero": own.zero, "counted": axis.odometer, "shortest": SHORTEST}
        if own.scale is not None:
            # The control reads it, wherever a screw has gone.
            drives.append(common | _scale(own.scale, step))
        elif own.screw is not None:
            along = own.screw.made.conduction
            tables.append(Table(f"rates_{k}", "Of the modes of a screw, 1/s.", along.rates))
            tables.append(Table(f"modes_{k}", "Their cells, mode by mode.", along.modes.T.copy()))
            drives.append(common | _screw(own.screw, step))
    cells = [drive["cells"] for drive in drives]
    most = max(cells, default=0)
    products = sum(4 * n * n + (2 * TERMS + 30) * n + 30 for n in cells)
    return Driven(
        drives,
        tables,
        sum(2 * n + 1 for n in cells) + 2 * most,
        Operations(products, products, sum((TERMS + 3) * n + 8 for n in cells), sum(cells)),
        Operations(20, 20, 4).times(2 * len(drives)),
    )


def _scale(scale: Scale, step: float) -> dict[str, Any]:
    return {
        "cells": 0,
        "expansion": scale.expansion,
        "offset": scale.head - scale.fixed,
        "kept": math.exp(-step / scale.lag) if scale.lag else 0.0,
    }


def _screw(screw: Screw, step: float) -> dict[str, Any]:
    made, along = screw.made, screw.made.conduction
    rod, film, heat, hold = made.rod, made.film, made.heat, made.hold
    cells = along.rates.size
    flexibility = 1.0 / (rod.material.youngs_modulus * rod.area)
    near, far = np.array(heat.bearings) * along.reaching / step
    return {
        "cells": cells,
        "width": rod.length / cells,
        "towards": screw.towards,
        "offset": screw.nut - screw.start,
        "still": film.still * along.surface / along.capacity,
        "added": film.added * along.surface / along.capacity,
        "speed": film.speed * step,
        "exponent": film.exponent,
        "nut": heat.nut / step,
        "half": 0.5 * heat.nut_length,
        "near": near,
        "far": far,
        "motor": heat.motor * along.reaching[0],
        "per_heat": 1.0 / along.capacity,
        "strain": rod.material.expansion * rod.length / cells,
        "tension": hold.tension,
        "seat": hold.compliance[0],
        "flexibility": flexibility,
        "whole": rod.length * flexibility + sum(hold.compliance),
    }
