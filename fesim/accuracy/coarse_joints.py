"""The same condensed machine with contact elements merged two by two.

Tractions and heat flows of merged elements are uniform, gaps and jumps are means: all are available
from a condensation on the finer elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.case.schema import Case
from fesim.joint.gap import singular
from fesim.march.assembly import tightened
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine, State
from fesim.setup.bolts import first_forces
from fesim.setup.laws import joint_laws
from fesim.setup.machine import Setup
from fesim.solid.condensation import ElasticCondensation, LoadInfluence, ThermalCondensation
from fesim.solid.friction_heat import FrictionHeat
from meshes.pairing import PairedJoint
from thermojoint.artefacts.arrays import Array

#: Shorter rows are not merged: a single element in a row would not resist rocking at all.
FEWEST = 3
#: Merged elements have similar normals: cosine of the largest angle between them.
ALIKE = 0.9
#: Condition number from which on a body of the merged machine is unconstrained.
FREE = 1e12


def merged_elements(joint: PairedJoint, first_alone: bool) -> tuple[NDArray[np.int64], float]:
    """Return the merged element of each contact element, (m,), and the factor on the error.

    An error of second order in the size of an element grows by up to four. The factor is one if
    nothing can be merged. Pairs begin with the first element of a row, or with the second, so that
    the first remains single.
    """
    place, ratios = joint.place.copy(), []
    for part in np.unique(place[:, 0]):
        own = place[:, 0] == part
        for way in (1, 2):
            count = int(place[own, way].max()) + 1
            if count >= FEWEST:
                place[own, way] = (place[own, way] + first_alone) // 2
                widths = np.bincount((np.arange(count) + first_alone) // 2)
                ratios.append(float((widths**3).sum()) / count)
    _, first, number = np.unique(place, axis=0, return_index=True, return_inverse=True)
    number = number.ravel()
    turned = np.einsum("mi,mi->m", joint.normal, joint.normal[first[number]]) < ALIKE
    number[turned] = len(first) + np.arange(np.count_nonzero(turned))
    _, number = np.unique(number, return_inverse=True)
    return number.ravel(), min(ratios, default=1.0)


def merged_joint(joint: PairedJoint, number: NDArray[np.int64]) -> PairedJoint:
    """Return a joint on merged elements, which have the frames of their first ones."""
    _, first = np.unique(number, return_index=True)
    area = np.bincount(number, joint.area).astype(np.float64)
    return replace(
        joint,
        normal=joint.normal[first],
        tangents=joint.tangents[first],
        element=number[joint.element],
        area=area,
        centre=np.stack([np.bincount(number, joint.area * x) / area for x in joint.centre.T], 1),
        piece_element=number[joint.piece_element],
        place=joint.place[first],
    )


def means_of(joints: Sequence[PairedJoint], numbers: Sequence[NDArray[np.int64]]) -> csr_array:
    """Return rows (M, m) of the means over merged elements, of all joints one after another."""
    starts = np.cumsum([0, *(number.max(initial=-1) + 1 for number in numbers)])
    owner = np.concatenate([start + own for start, own in zip(starts, numbers, strict=False)])
    area = np.concatenate([joint.area for joint in joints])
    whole = np.bincount(owner, area)
    return csr_array((area / whole[owner], (owner, np.arange(len(owner)))))


def merged_machine(
    case: Case,
    setup: Setup,
    thermal: ThermalCondensation,
    joints: Sequence[PairedJoint],
    means: csr_array,
) -> CondensedMachine:
    """Return the machine of a set-up on merged contact elements.

    Parameters
    ----------
    case : Case
        Case of the march.
    setup : Setup
        Its machine.
    thermal : ThermalCondensation
        The heat step to be merged.
    joints : sequence of PairedJoint
        The joints with merged elements.
    means : scipy.sparse.csr_array, shape (M, m)
        Result of `means_of`.

    Raises
    ------
    ConvergenceError
        A body is no longer held.
    """
    bolted = setup.bolts
    machine = setup.machine if bolted is None else bolted.loose
    contact, laws = machine.contact, joint_laws(case, setup.structure, setup.materials, joints)
    elastic, loads = _elastic(contact.elastic, contact.loads, means)
    coarse = replace(
        machine,
        friction=_merged_friction(machine.friction, means),
        thermal=merged_heat(thermal, means),
        contact=ContactProblem(elastic, laws, contact.gap_tolerance, loads=loads),
    )
    if bolted is None:
        return coarse
    return tightened(bolted.names, coarse, bolted.springs, first_forces(case))[0]


def merged_heat(thermal: ThermalCondensation, means: csr_array) -> ThermalCondensation:
    """Return a heat step whose joint heat flows are uniform over merged elements."""
    jump, influence = means @ thermal.jump, thermal.influence @ _shares(means)
    return replace(
        thermal,
        jump=jump,
        mean=means @ thermal.mean,
        influence=influence,
        joint_influence=np.asarray(jump @ influence),
        balance=replace(thermal.balance, flow=csr_array(thermal.balance.flow @ means.T)),
    )


def merged_state(state: State, means: csr_array) -> State:
    """Return a state on merged elements."""
    return replace(
        state,
        gap=state.gap @ means.T,
        slip=state.slip @ means.T,
        pressure=means @ state.pressure,
        change=state.change @ means.T,
        differences=np.zeros((len(state.differences), 3 * means.shape[0])),
        frozen=np.zeros((len(state.frozen), means.shape[0])),
        turning=np.zeros((len(state.turning), means.shape[0])),
    )


def _merged_friction(friction: FrictionHeat | None, means: csr_array) -> FrictionHeat | None:
    if friction is None:
        return None
    shares = _shares(means)
    counted = np.asarray(means @ friction.counted)
    return FrictionHeat(friction.into @ shares, friction.entering @ shares, counted)


def _shares(means: csr_array) -> Array:
    """Fraction (m, M) of each element in the heat flow of its merged one."""
    return np.asarray(means.T.toarray())


def _elastic(
    elastic: ElasticCondensation, loads: LoadInfluence | None, means: csr_array
) -> tuple[ElasticCondensation, LoadInfluence | None]:
    """Uniform tractions, and reference springs across the mean gaps of merged elements only.

    With z = P z_c and the spring forces transferred from one machine to the other, gaps are
    g = S_T T + C A (P w_c + D g), w_c = z_c + k_c g_c and D = k - P k_c R.
    """
    small = means.toarray()
    over = np.kron(np.eye(3), small)
    spread = np.kron(np.eye(3), (small > 0.0).T.astype(np.float64))
    area, reference = spread.T @ elastic.area, over @ elastic.reference
    moved = np.diag(elastic.reference) - spread @ (reference[:, None] * over)
    forced = elastic.compliance * elastic.area
    tangent = np.eye(len(forced)) - forced @ moved
    try:
        exchange = np.linalg.inv(tangent)
    except np.linalg.LinAlgError as error:
        raise singular() from error
    # In the 1-norm, for which the inverse is available: the 2-norm needs another decomposition.
    if not np.linalg.norm(tangent, 1) * np.linalg.norm(exchange, 1) < FREE:
        raise singular()
    returned = (elastic.probe_compliance * elastic.area) @ moved @ exchange
    by_force = (exchange @ forced) @ spread / area
    probed = (elastic.probe_compliance * elastic.area) @ spread / area
    merged = ElasticCondensation(
        compliance=np.ascontiguousarray(over @ by_force),
        thermal_gap=(over @ exchange) @ elastic.thermal_gap,
        probe_compliance=np.ascontiguousarray(probed + returned @ forced @ spread / area),
        probe_thermal=elastic.probe_thermal + returned @ elastic.thermal_gap,
        reference=reference,
        area=area,
    )
    if loads is None:
        return merged, None
    return merged, LoadInfluence(
        gap=over @ exchange @ loads.gap, probes=loads.probes + returned @ loads.gap
    )
