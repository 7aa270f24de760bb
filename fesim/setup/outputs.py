"""Optional outputs of a case: forces and stresses."""

from __future__ import annotations

import numpy as np
from scipy.sparse import block_diag, csr_array

from fesim.case.schema import Case
from fesim.setup.constraints import fixed_surfaces
from fesim.setup.discretised import Discretised
from fesim.setup.loads import spring_stiffnesses
from fesim.solid.condensation import DisplacementField
from fesim.solid.elasticity import held_directions
from fesim.solid.outputs import (
    MechanicalOutputs,
    Supports,
    condense_outputs,
    reaction_rows,
    with_stresses,
)
from fesim.solid.spaces import cells_around, probe_cells
from fesim.solid.stress import stress_rows
from thermojoint.artefacts.arrays import Array


def asks_for_outputs(case: Case) -> bool:
    """Whether forces or stresses are requested in a case."""
    return case.output.forces or bool(case.output.stress_probes)


def support_names(case: Case) -> list[str]:
    """Return the names of a case's supports in a response, in the order of its rows."""
    held = [*fixed_surfaces(case), *case.supports.symmetry]
    springs = [f"{name} springs" if name in held else name for name in case.supports.springs]
    return [*held, *springs]


def mechanical_outputs(
    whole: Discretised, field: DisplacementField, forces: Array
) -> MechanicalOutputs:
    """Condense the outputs that a case requests: three rows per support, six per stress probe.

    `forces` (n, l) are the nodal forces of the loads, N.
    """
    case, structure, spaces = whole.case, whole.parts.structure, whole.spaces
    held = held_directions(fixed_surfaces(case), case.supports.symmetry)
    springs = list(spring_stiffnesses(case, structure).items())
    supports = Supports(held, springs)
    rows = reaction_rows(structure, spaces, field, whole.springs, forces, supports)
    if case.output.stress_probes:
        probes = {name: structure.probes[name] for name in case.output.stress_probes}
        probe_cells(structure, probes)  # refuses points in no cell or on a joint
        around = [cells_around(structure, probe) for probe in probes.values()]
        count = [len(cells) for cells in around]
        points = np.array([probe.position for probe in probes.values()]).T.repeat(count, axis=1)
        stresses = stress_rows(structure, spaces, whole.materials, points, np.concatenate(around))
        # At a node, the stress of a single cell would depend on the order of the search.
        mean = block_diag([np.tile(np.eye(6) / n, n) for n in count], format="csr")
        rows = with_stresses(rows, *(csr_array(mean @ one) for one in stresses))
    return condense_outputs(field, rows, forces)
