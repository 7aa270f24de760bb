"""Drives of axes in an exported program: a ball screw or a scale, as in `reduced.axis_drive`.

Steps have the nominal length, so everything but the film is constant.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from estimator.export.program import Operations, Table
from estimator.joint_aware.observer_model import ObserverModel
from fesim.axes.ball_screw import SHORTEST
from fesim.axes.positioning import Scale, Screw
from fesim.march.exponential import phi_functions
from thermojoint.reduced.physics import heat_step

#: Terms of the series of phi_1 and phi_2, for decays below one.
TERMS = 18


class Driven(NamedTuple):
    """Data of drives for a template."""

    #: Parameters of each drive.
    drives: list[dict[str, Any]]
    tables: list[Table]
    #: Number of surfaces that screws heat, and of machine temperatures that act on drives.
    heated: int
    felt: int
    #: Number of values of the state.
    state: int
    #: Of the drives' step, and of their contribution at a place.
    step: Operations
    place: Operations


def driven(model: ObserverModel) -> Driven:
    """Return the data of the drives in the program of a model with moving axes."""
    every, step = model.modes.drives, model.step
    assert every is not None  # with axes
    drives, tables = list[dict[str, Any]](), list[Table]()
    for k, (axis, one) in enumerate(zip(model.moving_axes, every.each, strict=True)):
        if one is None:
            continue
        own = one.drive
        tables.append(Table(f"carried_{k}", "Displacement per error, per axis.", one.carried))
        common = {
            "axis": k,
            "cells": 0,
            # With seats, its contribution at the zero is found together with the lines.
            "zero": None if k in every.seated_zeros else own.zero,
            "counted": axis.odometer,
            "shortest": SHORTEST,
            "seat": one.seat.tolist(),
            "column": one.column.tolist(),
            "follows": one.follows,
        }
        if own.screw is not None:
            along = own.screw.made.conduction
            tables.append(Table(f"rates_{k}", "Of the modes of a screw, 1/s.", along.rates))
            tables.append(Table(f"modes_{k}", "Their cells, mode by mode.", along.modes.T.copy()))
            common |= _screw(own.screw, step)
        # The control reads the scale, regardless of the screw.
        drives.append(common | _scale(own.scale, step) if own.scale is not None else common)
    heated, felt = every.heated.shape[1], len(every.felt)
    if heated:
        given = heat_step(model.modes, step).drive[:, -heated:]
        tables.append(Table("given", "Modes per W of each surface that a screw heats.", given))
    if felt:
        tables.append(Table("felt_of", "What drives feel of the modes, K.", every.felt))
    cells = [drive["cells"] for drive in drives]
    most, scales = max(cells, default=0), sum("expansion" in drive for drive in drives)
    products = sum(4 * n * n + (4 * TERMS + 40) * n + 60 for n in cells)
    products += model.modes.rates.size * (heated + 2 * felt)
    return Driven(
        drives,
        tables,
        heated,
        felt,
        sum(2 * n + 1 for n in cells if n) + scales + 2 * most + heated + 2 * felt,
        Operations(products, products, sum((2 * TERMS + 3) * n + 8 for n in cells), sum(cells)),
        Operations(20, 20, 4).times(2 * len(drives)),
    )


def _scale(scale: Scale, step: float) -> dict[str, Any]:
    decay = step / scale.lag if scale.lag else math.inf
    one = float(phi_functions(np.array([decay]))[0][0]) if scale.lag else 0.0
    return {
        "expansion": scale.expansion,
        "head": scale.head - scale.fixed,
        "kept": math.exp(-decay),
        # Share of the change of the temperature that it follows, in a step.
        "taken": 1.0 - one,
    }


def _screw(screw: Screw, step: float) -> dict[str, Any]:
    made, along = screw.made, screw.made.conduction
    rod, film, heat, hold = made.rod, made.film, made.heat, made.hold
    cells = along.rates.size
    flexibility = 1.0 / (rod.material.youngs_modulus * rod.area)
    near, far = np.array(heat.bearings) / step
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
        "motor": heat.motor,
        "reaching": along.reaching.tolist(),
        "sinks": along.sinks.tolist(),
        "spared": (screw.spared / step).tolist(),
        "per_heat": 1.0 / along.capacity,
        "strain": rod.material.expansion * rod.length / cells,
        "tension": hold.tension,
        "gives": hold.compliance[0],
        "flexibility": flexibility,
        "whole": rod.length * flexibility + sum(hold.compliance),
    }
