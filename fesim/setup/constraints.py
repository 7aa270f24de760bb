"""Constraints of the bodies of a case, checked before any factorisation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fesim.case.schema import Case
from fesim.setup.laws import initial_opening
from fesim.setup.loads import spring_stiffnesses
from fesim.solid.bolts import Bolt
from fesim.solid.rigid_motions import Constraints, check_held, constraints_of
from meshes.pairing import PairedJoint
from meshes.structure import Structure

#: A contact element with a smaller initial opening than this is closed, m: rounding of coordinates.
CLOSED = 1e-9


def checked_constraints(
    case: Case, structure: Structure, joints: Sequence[PairedJoint], bolts: Sequence[Bolt] = ()
) -> Constraints:
    """Return the constraints of a case's bodies.

    Raises
    ------
    InputError
        A body is not constrained.
    """
    constraints = constraints_of(
        structure,
        joints,
        fixed_surfaces(case),
        dict(case.supports.symmetry),
        spring_stiffnesses(case, structure),
        bolts,
    )
    check_constrained(case, constraints, joints)
    return constraints


def check_constrained(case: Case, constraints: Constraints, joints: Sequence[PairedJoint]) -> None:
    """Refuse a body without constraints, unless only heat is simulated.

    Joints that start open do not constrain, unless there are loads. These may close them: the state
    at time zero is then the equilibrium in which the body rests on them, and the march refuses a
    step that leaves it loose.

    Raises
    ------
    InputError
        A body is not constrained; the message contains it and its motions.
    """
    if case.displacement is not None:
        closed = None if case.loads else start_closed(case, joints)
        check_held(constraints, _with_friction(case, joints), closed)


def fixed_surfaces(case: Case) -> list[str]:
    """Return the surfaces held in all directions: fixed ones, and those of rigid walls."""
    return [*case.supports.fixed, *case.walls]


def start_closed(case: Case, joints: Sequence[PairedJoint]) -> NDArray[np.bool_]:
    """Which contact elements do not start open, shape (m,)."""
    parts = [np.empty(0, dtype=bool)]
    for joint in joints:
        opening = initial_opening(case.joints[joint.name], joint)
        parts.append(np.ones(len(joint.area), bool) if opening is None else opening < CLOSED)
    return np.concatenate(parts)


def _with_friction(case: Case, joints: Sequence[PairedJoint]) -> NDArray[np.bool_]:
    """Which contact elements have friction, shape (m,)."""
    rough = [case.joints[joint.name].friction_coefficient > 0.0 for joint in joints]
    return np.repeat(np.array(rough, dtype=bool), [len(joint.area) for joint in joints])
