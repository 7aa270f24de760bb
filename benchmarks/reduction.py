"""The reduced thermal model against the full one: size, error, time, over meshes and joints.

Printed for each mesh and number of contact elements: full and reduced unknowns, the error that the
build found (relative to what is allowed), its time, and over the validation cases the largest
differences from the full march and the time of a step of both (medians; recording included). The
whole table takes about 10 minutes; both options may be repeated.

    python -m benchmarks.reduction --mesh reference --contacts 27 --contacts 192
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.study import case_file, options_of
from fesim.case.schema import Case, read_case
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine, Step
from fesim.march.reduced import (
    ThermalModes,
    outputs_of,
    project_elasticity,
    project_heat,
    thermal_modes,
)
from fesim.setup.loads import heat_sources
from fesim.setup.machine import Setup, set_up
from fesim.setup.structure import body_materials
from fesim.simulate import simulate
from fesim.solid.heat import ThermalLoads, heat_operators
from fesim.solid.joint_operators import joint_operators
from thermojoint.paper.inputs import VALIDATION

#: Name -> largest element edge in general and at the joint, mm.
MESHES = {"coarse": (100.0, 100.0), "reference": (50.0, 25.0), "fine": (33.0, 16.7)}
#: Contact elements -> along and across.
CONTACTS = {27: (9, 3), 75: (15, 5), 192: (24, 8)}
#: The whole fields are compared at every such step.
EVERY = 25


@dataclass(frozen=True)
class Differences:
    """Largest differences of the reduced march from the full one."""

    #: Of the recorded displacement, m; of the candidates' temperatures and of all nodes', K.
    displacement: float
    probe: float
    field: float
    #: Of the contact pressures, relative to the largest of them.
    pressure: float


def case_of(mesh: str, contacts: int) -> Case:
    """The reference case on another mesh, with other contact elements, of the full order."""
    data = read_case(case_file("equal_heights")).model_dump()
    size, joint_size = MESHES[mesh]
    data["structure"] |= {"element_size_mm": size, "joint_element_size_mm": joint_size}
    data["joints"]["knee"] |= dict(zip(("along", "across"), CONTACTS[contacts], strict=True))
    data["march"] |= {"thermal": "full"}
    return Case.model_validate(data)


def reduced(case: Case, full: Setup) -> tuple[Setup, ThermalModes, float]:
    """Reduce a set-up of the full order; return it, its modes and how long that took, s."""
    structure, thermal, elastic = full.structure, full.machine.thermal, full.machine.contact.elastic
    heat = heat_operators(
        structure,
        full.spaces.heat,
        body_materials(case, structure),
        ThermalLoads(case.convection_W_m2K, heat_sources(case, structure)),
    )
    operators = joint_operators(full.joints, full.spaces)
    begun = time.perf_counter()
    modes = thermal_modes(heat, operators, outputs_of(elastic, full.probe_rows), thermal.step)
    machine = CondensedMachine(
        project_heat(heat, operators, thermal.step, modes),
        ContactProblem(project_elasticity(elastic, modes), full.machine.contact.laws),
    )
    rows = full.probe_rows @ modes.basis
    took = time.perf_counter() - begun
    return replace(full, machine=machine, probe_rows=rows, modes=modes), modes, took


def marched(case: Case, setup: Setup) -> tuple[dict[str, np.ndarray], float]:
    """Run a case; return what is compared and the time of a step, s."""
    fields: list[np.ndarray] = []
    begun = time.perf_counter()
    response = simulate(case, setup=setup, on_step=_keeping(setup, fields), accuracy=False).response
    took = (time.perf_counter() - begun) / (response.sizes["time"] - 1)
    names = ("displacement", "temperature", "pressure")
    values = {name: response[name].to_numpy() for name in names}
    return values | {"field": np.array(fields)}, took


def _keeping(setup: Setup, fields: list[np.ndarray]) -> Callable[[Step], None]:
    def keep(step: Step) -> None:
        if step.state.index % EVERY == 0:
            fields.append(setup.nodal_temperature(step.state))

    return keep


def differences(full: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> Differences:
    """Compare two runs of one case."""
    largest = {name: float(np.abs(value - other[name]).max()) for name, value in full.items()}
    return Differences(
        largest["displacement"],
        largest["temperature"],
        largest["field"],
        largest["pressure"] / float(full["pressure"].max()),
    )


def row(mesh: str, contacts: int) -> list[str]:
    """One line of the table."""
    case = case_of(mesh, contacts)
    full = set_up(case)
    other, modes, building = reduced(case, full)
    found, steps_full, steps_reduced = [], [], []
    for heat_input in VALIDATION.values():
        run = case.model_copy(update={"heat_input": heat_input})
        (one, slow), (two, fast) = marched(run, full), marched(run, other)
        found.append(differences(one, two))
        steps_full.append(slow)
        steps_reduced.append(fast)
    worst = {name: max(getattr(d, name) for d in found) for name in vars(found[0])}
    return [
        mesh,
        str(full.machine.contact.count),
        str(full.spaces.heat.N),
        str(modes.rates.size),
        f"{modes.error:.2f}",
        f"{building:.1f}",
        f"{1e6 * worst['displacement']:.1e}",
        f"{1e3 * worst['probe']:.3f}",
        f"{1e3 * worst['field']:.3f}",
        f"{worst['pressure']:.1e}",
        f"{1e3 * median(steps_full):.2f}",
        f"{1e3 * median(steps_reduced):.2f}",
    ]


def main() -> None:
    """Print the table."""
    parser = options_of(__doc__)
    parser.add_argument("--mesh", action="append", choices=list(MESHES))
    parser.add_argument("--contacts", action="append", type=int, choices=list(CONTACTS))
    given = parser.parse_args()
    table = Table(
        "mesh",
        "contacts",
        "unknowns",
        "modes",
        "error",
        "build, s",
        "δ, µm",
        "probes, mK",
        "field, mK",
        "pressure / peak",
        "full step, ms",
        "reduced step, ms",
    )
    console = Console(width=150)
    for mesh in given.mesh or MESHES:
        for contacts in given.contacts or CONTACTS:
            line = row(mesh, contacts)
            print(" | ".join(line), flush=True)
            table.add_row(*line)
    console.print(table)


if __name__ == "__main__":
    main()
