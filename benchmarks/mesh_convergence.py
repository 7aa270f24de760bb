"""Mesh convergence of the equal-heights machine: displacement, its nonlinear part, peak pressure.

Each mesh halves the element size of the last, everywhere and near the joint. The limit is
extrapolated from the three finest (Richardson, with the observed order); the error of a mesh is its
distance from that limit.

    python -m benchmarks.mesh_convergence            # about 6 minutes
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from benchmarks.study import case_file, options_of
from fesim.case.schema import Case, ProbeSection, read_case
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate

#: (element size, element size near the joint), mm.
SIZES = ((200.0, 100.0), (100.0, 50.0), (50.0, 25.0), (25.0, 12.5))
LEVEL = 3.0


@dataclass(frozen=True)
class Result:
    """Compared quantities."""

    label: str
    unknowns: int
    values: dict[str, float]
    seconds: float


def run(case: Case, size: float, near: float) -> Result:
    """March one mesh at heat inputs 1 and `LEVEL`."""
    began = perf_counter()
    mesh = case.structure.model_copy(
        update={"element_size_mm": size, "joint_element_size_mm": near}
    )
    setup = set_up(case.model_copy(update={"structure": mesh}))

    def response(level: float) -> xr.Dataset:
        heat = StepInput(kind="step", level=level)
        return simulate(case.model_copy(update={"heat_input": heat}), setup=setup).response

    one, high = response(1.0), response(LEVEL)
    total = 1e6 * high["displacement"].to_numpy()
    nonlinear = total - LEVEL * 1e6 * one["displacement"].to_numpy()
    values = {
        "δx, µm": float(total[-1, 0]),
        "δy, µm": float(total[-1, 1]),
        "δNL x, µm": float(nonlinear[-1, 0]),
        "δNL y, µm": float(nonlinear[-1, 1]),
        "peak pressure, MPa": float(high["pressure"].max()) / 1e6,
    }
    unknowns = int(high.attrs["displacement_unknowns"])
    return Result(f"{size:g}/{near:g}", unknowns, values, perf_counter() - began)


def limit(values: list[float]) -> tuple[float, float]:
    """Extrapolate the last three of a sequence of halvings; return the limit and the order.

    Where the sequence does not converge monotonically, no order can be read from it: the limit is
    the last value and the order NaN.
    """
    first, second, third = values[-3:]
    ratio = (first - second) / (second - third) if second != third else np.inf
    if not ratio > 1.0:
        return third, float("nan")
    return third - (second - third) / (ratio - 1.0), float(np.log2(ratio))


def main() -> None:
    """Run the meshes and print the table."""
    parser = options_of(__doc__)
    parser.add_argument("--case", type=Path, help="case file; default: the equal-heights machine")
    # Fewer than three have no limit.
    parser.add_argument(
        "--meshes",
        type=int,
        choices=range(3, len(SIZES) + 1),
        default=len(SIZES),
        help="how many, coarsest first",
    )
    options = parser.parse_args()
    case = read_case(options.case or case_file("equal_heights")).model_copy(
        update={"candidates": []}
    )
    nose = ProbeSection(position_mm=(600.0, 1050.0, 250.0), body="column")
    case = case.model_copy(update={"probes": {"nose": nose}})
    results = [run(case, *sizes) for sizes in SIZES[: options.meshes]]
    table = Table("mesh, mm", "unknowns", *results[0].values, "s")
    for result in results:
        shown = [f"{value:.3f}" for value in result.values.values()]
        table.add_row(result.label, str(result.unknowns), *shown, f"{result.seconds:.0f}")
    limits = {name: limit([r.values[name] for r in results]) for name in results[0].values}
    table.add_row("limit", "", *(f"{value:.3f}" for value, _ in limits.values()), "")
    table.add_row("order", "", *(f"{order:.2f}" for _, order in limits.values()), "")
    for result in results:
        errors = [100.0 * abs(result.values[n] / limits[n][0] - 1.0) for n in result.values]
        table.add_row(f"error {result.label}", "", *(f"{e:.1f} %" for e in errors), "")
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
