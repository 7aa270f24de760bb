"""Candidates for the sensors of a machine whose case has none: nodes of its mesh.

They lie around the strongest source, within the source's size, and on both sides of every joint;
each set is thinned to points that are as far apart as possible.
"""

from __future__ import annotations

import numpy as np

from fesim.case.schema import Case, ProbeSection
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

#: Number of candidates around the source, and on all joints together.
EACH = 48


def with_candidates(case: Case, structure: Structure) -> Case:
    """Return a case with candidate probes for the sensors.

    Parameters
    ----------
    case : Case
        Case with a source and a joint.
    structure : Structure
        Structure of the case.
    """
    mesh = structure.mesh
    owner = np.empty(mesh.nelements, dtype=int)
    for k, cells in enumerate(structure.bodies.values()):
        owner[cells] = k
    source = max(case.sources.values(), key=lambda one: one.count * one.reference_power_W)
    if source.surface is None:
        nodes = np.unique(mesh.t[:, structure.bodies[source.body or ""]])
        heated = list(structure.bodies).index(source.body or "")
    else:
        facets = structure.surfaces[source.surface]
        nodes, heated = np.unique(mesh.facets[:, facets]), int(owner[mesh.f2t[0, facets[0]]])
    at = mesh.p[:, nodes]
    near = np.unique(mesh.t[:, owner == heated])
    apart = np.linalg.norm(mesh.p[:, near] - at.mean(axis=1)[:, None], axis=0)
    pool = [(near[apart <= np.linalg.norm(np.ptp(at, axis=1))], heated)]
    of_joints = []
    for side in (side for sides in structure.joints.values() for side in sides):
        facets = structure.surfaces[side]
        of_joints.append((np.unique(mesh.facets[:, facets]), int(owner[mesh.f2t[0, facets[0]]])))
    bodies = list(structure.bodies)
    probes = {}
    for group in (pool, of_joints):
        numbers = np.concatenate([nodes for nodes, _ in group])
        owners = np.repeat([body for _, body in group], [len(nodes) for nodes, _ in group])
        for k in spread(mesh.p[:, numbers].T, EACH):
            x, y, z = (round(float(value), 6) for value in 1e3 * mesh.p[:, numbers[k]])
            body = bodies[owners[k]]
            probes[f"{body}_{x:g}_{y:g}_{z:g}"] = ProbeSection(position_mm=(x, y, z), body=body)
    return case.model_copy(update={"probes": probes | case.probes})


def spread(points: Array, count: int) -> list[int]:
    """Return the indices of up to `count` distinct points (n, 3), each farthest from earlier ones.

    The first is the point nearest to the centre.
    """
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(distance.argmin())]
    reach = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count and reach.max() > 0.0:
        chosen.append(int(reach.argmax()))
        reach = np.minimum(reach, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen
