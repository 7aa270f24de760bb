"""Bars on a reduced thermal model, heated to and fro."""

import numpy as np
from bars import assemble, surface_law, two_bars

from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.reduced import outputs_of, project_elasticity, project_heat, thermal_modes
from fesim.solid.spaces import probe_rows


def bars_of(step=2.0, friction=0.3):
    return assemble(
        two_bars(left=(4, 4, 2), right=(4, 4, 2)),
        law=surface_law(friction),
        convection={"bottom": 50.0},
        sources={"left_top": 1.0},
        fixed=["left_end", "right_end"],
        step=step,
    )


def modes_of(bars, step=2.0):
    parts = bars.parts
    rows = probe_rows(parts.spaces.heat, parts.structure, parts.structure.probes)
    return thermal_modes(
        parts.heat, parts.operators, outputs_of(bars.machine.contact.elastic, rows), step
    )


def on_modes(bars, modes, step=2.0):
    joints = bars.machine.contact
    return CondensedMachine(
        project_heat(bars.parts.heat, bars.parts.operators, step, modes),
        ContactProblem(project_elasticity(joints.elastic, modes), joints.laws),
    )


def warmed(count, times=(0.0, 40.0, 60.0, 200.0), watts=(0.0, 900.0, -900.0, 600.0)):
    """Inputs of steps of 2 s: heat that turns, so that the joint slides and sticks again."""
    heat = np.interp(2.0 * (1.0 + np.arange(count)), times, watts)
    return np.column_stack([heat, np.zeros(count)])
