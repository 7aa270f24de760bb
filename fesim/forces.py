"""Reactions, joint forces, stresses and their balance, for the response."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fesim.case.schema import Case
from fesim.march.machine import Step, load_factors
from fesim.setup.machine import Setup
from fesim.setup.outputs import support_names
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.stress import COMPONENTS, principal, von_mises
from meshes.pairing import PairedJoint
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Names of the stresses of a point, and of its principal stresses.
COMPONENT_NAMES = tuple("".join(DIRECTIONS[i] for i in pair) for pair in COMPONENTS)
ORDER_NAMES = ("first", "second", "third")
#: Sum of forces below which the balance of forces is relative to it, N.
NO_FORCE = 1e-3
#: A bolt that pushes by more than this fraction of its initial force has come loose.
LOOSE = 1e-6

Coords = dict[str, np.ndarray | list[str]]


def outputs_of(setup: Setup, step: Step) -> Array:
    """Return forces of the bolts (b,), then the mechanical outputs (o,) that the case requests.

    Raises
    ------
    ConvergenceError
        A bolt would have to push: it has come loose.
    """
    acting = setup.acting(step)
    pulls = acting[setup.forces.shape[1] - _bolt_count(setup) :]
    check_tight(setup, pulls, setup.machine.thermal.step * step.state.index)
    if setup.outputs is None:
        return pulls
    strained = setup.machine.strained(step.state.temperature)
    outputs = setup.outputs.of(strained, step.remainder, acting)
    return np.concatenate([pulls, outputs])


def _bolt_count(setup: Setup) -> int:
    return 0 if setup.bolts is None else len(setup.bolts.names)


def check_tight(setup: Setup, pulls: Array, time: float) -> None:
    """Check the bolt forces (b,), N, at a time, s: bolts cannot push.

    Raises
    ------
    ConvergenceError
        A bolt would have to push: it has come loose.
    """
    if setup.bolts is None or setup.machine.assembly is None:
        return
    given = setup.machine.assembly.factors[-1 - len(pulls) : -1]
    loose = np.flatnonzero(pulls < -LOOSE * given)
    if loose.size:
        raise ConvergenceError(
            f"t = {time:g} s: bolt {setup.bolts.names[loose[0]]!r} has come loose: it would have "
            "to push; raise its force_kN, or check what loosens it"
        )


def mechanical_values(
    case: Case, setup: Setup, steps: Sequence[Step], outputs: Array
) -> tuple[dict[str, np.ndarray], Coords]:
    """Return forces and stresses for the response, and their coordinates.

    Parameters
    ----------
    case, setup
        The case and its set-up.
    steps : sequence of Step
        The n steps.
    outputs : ndarray, shape (n, b + o)
        `outputs_of` each step.
    """
    bolts = _bolt_count(setup)
    pulls, outputs = outputs[:, :bolts], outputs[:, bolts:]
    values: dict[str, np.ndarray] = {"bolt_force": pulls} if bolts else {}
    coords: Coords = {"bolt": list(case.bolts)} if bolts else {}
    if setup.outputs is None:
        return values, coords
    supports, points = support_names(case), case.output.stress_probes
    count = 3 * len(supports)
    reaction = outputs[:, :count].reshape(len(steps), -1, 3)
    if case.output.forces:
        # The forces of a bolt on its two ends cancel.
        loads = len(case.loads)
        factors = np.array([load_factors(setup.machine, step.inputs)[:loads] for step in steps])
        acting = setup.forces[:, :loads]
        load = factors @ np.stack([acting[i::3].sum(axis=0) for i in range(3)], axis=1)
        values |= {"reaction": reaction, "force_balance": force_balance(reaction, load)}
        coords |= {"support": supports}
        if setup.joints:
            values |= _joint_values(setup, steps)
            coords |= {"joint": [joint.name for joint in setup.joints]}
    if points:
        stress = outputs[:, count:].reshape(len(steps), -1, 6)
        values |= {
            "stress": stress,
            "von_mises": von_mises(stress),
            "principal_stress": principal(stress),
        }
        coords |= {
            "stress_probe": points,
            "component": list(COMPONENT_NAMES),
            "order": list(ORDER_NAMES),
        }
    return values, coords


def force_balance(reaction: Array, load: Array) -> Array:
    """Return the norm of (supports + loads) over the sum of norms, shape (n,); 0 in equilibrium.

    Parameters
    ----------
    reaction : ndarray, shape (n, supports, 3)
        Forces of the supports on the structure, N.
    load : ndarray, shape (n, 3)
        Sum of the loads, N.
    """
    rest = np.linalg.norm(reaction.sum(axis=1) + load, axis=1)
    size = np.linalg.norm(reaction, axis=2).sum(axis=1) + np.linalg.norm(load, axis=1)
    return np.asarray(rest / np.maximum(size, NO_FORCE))


def _joint_values(setup: Setup, steps: Sequence[Step]) -> dict[str, np.ndarray]:
    contacts = setup.machine.contact.count
    springs = setup.machine.contact.elastic.reference
    # z = remainder - k g: the shear on the gap.
    shear = np.array(
        [(step.remainder - springs * step.state.gap.ravel())[contacts:] for step in steps]
    ).reshape(len(steps), 2, contacts)
    pressure = np.array([step.state.pressure for step in steps])
    forces, moments, start = [], [], 0
    for joint in setup.joints:
        own = slice(start, start + len(joint.area))
        force, moment = joint_resultant(joint, pressure[:, own], shear[..., own])
        forces.append(force)
        moments.append(moment)
        start = own.stop
    return {
        "shear": shear.transpose(0, 2, 1),
        "joint_force": np.stack(forces, axis=1),
        "joint_moment": np.stack(moments, axis=1),
    }


def joint_resultant(joint: PairedJoint, pressure: Array, shear: Array) -> tuple[Array, Array]:
    """Return force (N) and moment about the joint's centroid (N m) on side b, shapes (n, 3).

    Parameters
    ----------
    joint : PairedJoint
        Joint with m contact elements; the force of each acts at its centre.
    pressure : ndarray, shape (n, m)
        Contact pressure, Pa.
    shear : ndarray, shape (n, 2, m)
        Shear tractions along both tangents, Pa.
    """
    along = np.einsum("ntm,mtx->nmx", shear, joint.tangents)
    each = joint.area[:, None] * (pressure[..., None] * joint.normal + along)
    arms = joint.centre - joint.area @ joint.centre / joint.area.sum()
    return each.sum(axis=1), np.cross(arms, each).sum(axis=1)
