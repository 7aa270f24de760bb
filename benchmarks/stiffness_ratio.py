"""Effect of the tolerance of the gap equations if one body is much stiffer than the other.

Run: ``python -m benchmarks.stiffness_ratio``. The equal-heights machine with elements of 100 mm and
twice the heat, its column stiffer and stiffer. Prints the table of docs/march.md: what an accepted
residual can mean at most in the last state, for the gaps and for the pressures, and by how much
pressures and displacement really differ from a march that is far more strict.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from benchmarks.study import coarse_machine_data
from fesim.case.schema import case_from_data
from fesim.joint.gap import TOLERANCE
from fesim.joint.law import NORMAL
from fesim.march.machine import CondensedMachine, Step
from fesim.march.stepping import Inputs, march, staggered
from fesim.setup.loads import thermal_inputs
from fesim.setup.machine import set_up

RATIOS = (1.0, 1e3, 1e6, 1e9)
STEPS = 350
#: Of the march that the other is compared with, m.
STRICT = 1e-3 * TOLERANCE


def machine(ratio: float) -> tuple[CondensedMachine, Inputs]:
    """Return the machine whose column is `ratio` times as stiff, and its inputs."""
    data = coarse_machine_data()
    iron = data["materials"]["cast_iron"]
    stiff = iron | {"youngs_modulus_GPa": ratio * iron["youngs_modulus_GPa"]}
    data["materials"]["stiff"] = stiff
    data["bodies"]["column"] = "stiff"
    data["heat_input"]["level"] = 2.0
    case = case_from_data(data, f"ratio {ratio:g}", Path())
    return set_up(case).machine, thermal_inputs(case)


def bound(machine: CondensedMachine, before: Step, step: Step) -> tuple[float, float]:
    """Return the largest errors of a gap (m) and of a pressure (1, of its preload)."""
    traction = machine.contact.traction(step.state.gap, before.state.slip)
    jacobian = machine.contact.gap_problem.jacobian(traction)
    gap = np.abs(np.linalg.inv(jacobian)).sum(axis=1) * TOLERANCE
    pressure = (
        np.abs(traction.tangent[NORMAL]) * gap[: machine.contact.count] / machine.contact.preload
    )
    return float(gap.max()), float(pressure.max())


def row(ratio: float) -> tuple[str, ...]:
    """Return one row of the table as text."""
    usual, inputs = machine(ratio)
    strict = replace(usual, contact=replace(usual.contact, gap_tolerance=STRICT))
    ours, theirs = (list(islice(march(one, inputs, staggered), STEPS)) for one in (usual, strict))
    off = max(
        float((np.abs(a.state.pressure - b.state.pressure) / usual.contact.preload).max())
        for a, b in zip(ours, theirs, strict=True)
    )
    moved = max(
        float(np.abs(a.displacement - b.displacement).max())
        for a, b in zip(ours, theirs, strict=True)
    )
    gap, pressure = bound(usual, ours[-2], ours[-1])
    return (f"{ratio:.0e}", f"{gap:.1e}", f"{pressure:.1e}", f"{off:.1e}", f"{moved:.1e}")


def main() -> None:
    """Print the table."""
    header = (
        "column over table",
        "bound of a gap, m",
        "bound of a pressure, of the preload",
        "pressure off, of the preload",
        "displacement off, m",
    )
    for line in chain([header, ("---",) * len(header)], map(row, RATIOS)):
        print("| " + " | ".join(line) + " |", flush=True)


if __name__ == "__main__":
    main()
