"""What holds the bodies of a case, checked before anything is factorised."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fesim.case.schema import Case
from fesim.setup.loads import spring_stiffnesses
from fesim.solid.rigid_motions import Holds, check_held, holds_of
from meshes.pairing import PairedJoint
from meshes.structure import Structure


def checked_holds(case: Case, structure: Structure, joints: Sequence[PairedJoint]) -> Holds:
    """Return what holds the bodies of a case.

    Raises
    ------
    InputError
        Nothing holds one of them.
    """
    holds = holds_of(
        structure,
        joints,
        case.supports.fixed,
        dict(case.supports.symmetry),
        spring_stiffnesses(case, structure),
    )
    check_held(holds, with_friction(case, joints))
    return holds


def with_friction(case: Case, joints: Sequence[PairedJoint]) -> NDArray[np.bool_]:
    """Which contact elements have friction, shape (m,)."""
    rough = [case.joints[joint.name].friction_coefficient > 0.0 for joint in joints]
    return np.repeat(np.array(rough, dtype=bool), [len(joint.area) for joint in joints])
