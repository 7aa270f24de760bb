"""Additional displacement of bodies because their modulus depends on temperature.

The joints are settled again in every iteration (`fesim.solid.variable_stiffness`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fesim.march.secant_step import DEPTH, accelerated
from fesim.solid.variable_stiffness import VariableStiffness
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Largest change of a displacement in the last iteration, relative to the largest displacement.
TOLERANCE = 1e-9
#: Largest number of iterations.
MOST = 200


class Acting(NamedTuple):
    """Temperatures T and equivalent ones theta (n_heat,), K; factors of the loads (l,)."""

    temperature: Array
    strained: Array
    factors: Array


class Lift(NamedTuple):
    """Displacement due to the changed modulus: of gaps (3 m,), probes (k,) and nodes (n,), m.

    `moved` (n,) is the whole displacement.
    """

    gap: Array
    probes: Array
    field: Array
    moved: Array


def lifted(stiffness: VariableStiffness, acting: Acting, settle: Callable[[Array], Array]) -> Lift:
    """Find the displacement added by a changed modulus, in equilibrium with the joints.

    Parameters
    ----------
    stiffness : VariableStiffness
        Temperature-dependent part of the stiffness.
    acting : Acting
        Temperatures and loads.
    settle : callable
        From the added gap (3 m,), m, to the resulting z + k g of the joints (3 m,), Pa.

    Raises
    ------
    ConvergenceError
        The iteration does not converge.
    """
    field = stiffness.field()
    load = field.structure.thermal_load @ acting.strained
    if len(acting.factors):
        load = load + stiffness.forces @ acting.factors
    at = np.zeros(len(load))
    guesses: list[Array] = []
    changes: list[Array] = []
    for _ in range(MOST):
        pressed = load
        if len(field.area):
            pressed = load + field.gap.T @ (field.area * settle(field.gap @ at))
        moved = field.respond(pressed, "changed modulus") + at
        forces = stiffness.load(acting.temperature, acting.strained, moved)
        after = field.respond(forces, "changed modulus")
        change = after - at
        size = float(np.abs(change).max())
        if size <= TOLERANCE * float(np.abs(moved).max()):
            return Lift(field.gap @ after, stiffness.probes @ after, after, moved + change)
        if not np.isfinite(size):
            break
        guesses, changes = [*guesses[-DEPTH:], at], [*changes[-DEPTH:], change]
        at = accelerated(guesses, changes)
    raise ConvergenceError(
        f"youngs_modulus_factor: displacements still change by {size:.1e} m; take a smaller change "
        "of the modulus"
    )
