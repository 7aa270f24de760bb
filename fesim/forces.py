"""Forces and stresses of a march, for its response: supports, joints, points, and their balance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from artefacts.arrays import Array
from fesim.case.schema import Case
from fesim.march.stepping import Step, load_factors
from fesim.setup.machine import Setup
from fesim.setup.outputs import support_names
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.stress import COMPONENTS, principal, von_mises
from meshes.pairing import PairedJoint

#: Names of the stresses of a point, and of its principal stresses.
COMPONENT_NAMES = tuple("".join(DIRECTIONS[i] for i in pair) for pair in COMPONENTS)
ORDER_NAMES = ("first", "second", "third")
#: Forces below this in all count as none, N: their balance is relative to it.
NO_FORCE = 1e-3

Coords = dict[str, np.ndarray | list[str]]


def outputs_of(setup: Setup, step: Step) -> Array:
    """Return the mechanical outputs (o,) of one step; none if the case asks for none.

    Parameters
    ----------
    setup : Setup
        What marches.
    step : Step
        With its temperature.
    """
    if setup.outputs is None:
        return np.empty(0)
    factors = load_factors(setup.machine, step.inputs)
    strained = setup.machine.strained(step.state.temperature)
    return setup.outputs.of(strained, step.remainder, factors)


def mechanical_values(
    case: Case, setup: Setup, steps: Sequence[Step], outputs: Array
) -> tuple[dict[str, np.ndarray], Coords]:
    """Return what the response says of forces and stresses, and its coordinates.

    Parameters
    ----------
    case, setup
        What was marched.
    steps : sequence of Step
        n of them.
    outputs : ndarray, shape (n, o)
        `outputs_of` each.
    """
    if setup.outputs is None:
        return {}, {}
    supports, points = support_names(case), case.output.stress_probes
    count = 3 * len(supports)
    reaction = outputs[:, :count].reshape(len(steps), -1, 3)
    values: dict[str, np.ndarray] = {}
    coords: Coords = {}
    if case.output.forces:
        factors = np.array([load_factors(setup.machine, step.inputs) for step in steps])
        load = factors @ setup.forces.reshape(-1, 3, setup.forces.shape[1]).sum(axis=0).T
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
    """Return (supports + loads) over their sizes, shape (n,): zero in equilibrium.

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
    contacts = setup.machine.contacts
    springs = setup.machine.elastic.reference
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
        With its m contact elements; each acts at its centre.
    pressure : ndarray, shape (n, m)
        Pa.
    shear : ndarray, shape (n, 2, m)
        Along both tangents, Pa.
    """
    along = np.einsum("ntm,mtx->nmx", shear, joint.tangents)
    each = joint.area[:, None] * (pressure[..., None] * joint.normal + along)
    arms = joint.centre - joint.area @ joint.centre / joint.area.sum()
    return each.sum(axis=1), np.cross(arms, each).sum(axis=1)
