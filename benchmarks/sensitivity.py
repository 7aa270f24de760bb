"""Effect of each reading of the paper on the displacement of the equal-heights machine.

Every variant is the equal-heights case file with one edit. Printed: total displacement at the end
of the step at heat input 3, and its nonlinear part.

    python -m benchmarks.sensitivity            # about 3 minutes
"""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.study import case_data
from fesim.batch.paths import with_values
from fesim.batch.summary import is_open
from fesim.case.schema import case_from_data
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate

LEVEL = 3.0

#: name -> edits of the case file: dotted key and value.
VARIANTS: dict[str, dict[str, object]] = {
    "reference": {},
    "friction 0.15": {"joints.knee.friction_coefficient": 0.15},
    "friction 0.2": {"joints.knee.friction_coefficient": 0.2},
    "friction 0.3": {"joints.knee.friction_coefficient": 0.3},
    "friction 10 (sticks)": {"joints.knee.friction_coefficient": 10.0},
    "tangential stiffness ratio 0.3": {"joints.knee.tangential_stiffness_ratio": 0.3},
    "295 W in total": {"sources.bearings.reading": "total"},
    "90 W per source": {"sources.bearings.reference_power_W": 90.0},
    "conductance 1.25, 0.95": {"joints.knee.conductance.law": "yovanovich-1982"},
    "conductance exact CMY": {"joints.knee.conductance.law": "cmy-exact"},
    "normal law Back-Burdekin": {"joints.knee.normal_law": "back-burdekin"},
    "preload 2 MPa": {"joints.knee.preload_MPa": 2.0},
    "one contact element across": {"joints.knee.across": 1},
    "18 x 3 contact elements": {"joints.knee.along": 18},
    "convection 12 W/m2K": {"convection_W_m2K.exterior": 12.0},
    "source 100 mm lower": {"structure.dimensions_mm.source_top": 650.0},
    "source 150 mm lower, mid-strip": {"structure.dimensions_mm.source_top": 600.0},
    "iterated coupling": {"march.coupling": "iterated"},
}


def main() -> None:
    """Run the variants and print the table."""
    data = case_data("equal_heights")
    data["candidates"] = []
    data["probes"] = {"nose": {"position_mm": [600.0, 1050.0, 250.0], "body": "column"}}
    table = Table("variant", "δx, µm", "δy, µm", "δNL x, µm", "δNL y, µm", "open elements")
    for name, edits in VARIANTS.items():
        case = case_from_data(with_values(data, edits), name, Path())
        setup = set_up(case)
        found = {
            level: simulate(
                case.model_copy(update={"heat_input": StepInput(kind="step", level=level)}),
                setup=setup,
            ).response
            for level in (1.0, LEVEL)
        }
        total = 1e6 * found[LEVEL]["displacement"].to_numpy()[-1]
        nonlinear = total - LEVEL * 1e6 * found[1.0]["displacement"].to_numpy()[-1]
        pressure = found[LEVEL]["pressure"].to_numpy()
        share = is_open(pressure)[-1].mean()
        table.add_row(
            name,
            *(f"{value:.2f}" for value in (*total[:2], *nonlinear[:2])),
            f"{100.0 * share:.0f} %",
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
