"""Does the march always converge? Heat, friction, preload and normal law swept on the machine.

Run: ``python benchmarks/robustness.py [--markdown docs/robustness.md]``. The structure is condensed
once: neither heat nor joint law enters the condensation. Exit code 1 if a march fails.
"""

from __future__ import annotations

import argparse
import itertools
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import track
from rich.table import Table

from artefacts.errors import ConvergenceError
from artefacts.files import write_text
from fesim.batch.summary import OPEN_BELOW, is_open
from fesim.case.schema import Case, StepInput, TriangleInput, case_from_data
from fesim.setup.machine import set_up, with_laws
from fesim.simulate import simulate

HEATS = (0.1, 0.5, 1.0, 2.0, 3.0, 4.5, 6.0)
FRICTIONS = (0.0, 0.15, 0.3, 0.6, 1.0)
PRELOADS = (0.1, 1.0, 4.41, 10.0, 20.0)
NORMAL_LAWS = ("surface", "back-burdekin")
#: In-step iteration costs more: it is tried on fewer combinations.
ITERATED = {"heats": (0.5, 3.0, 6.0), "frictions": (0.0, 0.3, 1.0), "preloads": (0.1, 4.41, 20.0)}


@dataclass(frozen=True)
class Figures:
    """What the marches of one group came to."""

    marches: int
    failed: int
    steps: int
    iterations: int
    most_iterations: int
    cuts: int
    residual: float
    balance: float
    most_open: float


def cases(coupling: str) -> Iterator[tuple[tuple[str, float], Case]]:
    """Yield ((normal law, preload), case) over the sweep: steps, and triangles from 3 on."""
    text = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
    data = tomllib.loads(text)
    data["structure"] = {"kind": "box_milling_machine", "element_size_mm": 100.0}
    data["march"]["coupling"] = coupling
    data["candidates"] = []
    data["probes"] = {"T1": {"position_mm": [625.0, 450.0, 87.5], "body": "column"}}
    few = coupling == "iterated"
    heats = ITERATED["heats"] if few else HEATS
    frictions = ITERATED["frictions"] if few else FRICTIONS
    preloads = ITERATED["preloads"] if few else PRELOADS
    for law, preload, friction in itertools.product(NORMAL_LAWS, preloads, frictions):
        joint = {"normal_law": law, "preload_MPa": preload, "friction_coefficient": friction}
        data["joints"]["knee"] |= joint
        case = case_from_data(data, "robustness", Path())
        inputs = [StepInput(kind="step", level=level) for level in heats]
        inputs += [
            TriangleInput(kind="triangle", peak=peak, duration_min=10.0)
            for peak in heats
            if peak >= 3.0
        ]
        for heat in inputs:
            yield (law, preload), case.model_copy(update={"heat_input": heat})


def figures(responses: list[xr.Dataset], failed: int) -> Figures:
    """Sum up the marches of one group."""
    together = {
        name: np.concatenate([np.abs(one[name].to_numpy().ravel()) for one in responses])
        for name in ("iterations", "cuts", "gap_residual", "heat_balance")
    }
    opened = [is_open(one["pressure"].to_numpy()).mean(axis=1).max() for one in responses]
    return Figures(
        marches=len(responses) + failed,
        failed=failed,
        steps=sum(one.sizes["time"] - 1 for one in responses),
        iterations=int(together["iterations"].sum()),
        most_iterations=int(together["iterations"].max()),
        cuts=int(together["cuts"].sum()),
        residual=float(together["gap_residual"].max()),
        balance=float(together["heat_balance"].max()),
        most_open=float(max(opened)),
    )


def sweep(coupling: str) -> dict[tuple[str, float], Figures]:
    """March every case; return the figures by (normal law, preload)."""
    groups: dict[tuple[str, float], tuple[list[xr.Dataset], list[str]]] = {}
    setup = None
    for group, case in track(list(cases(coupling)), coupling, console=Console(stderr=True)):
        setup = set_up(case) if setup is None else with_laws(setup, case)
        done, failed = groups.setdefault(group, ([], []))
        try:
            response = simulate(case, setup=setup).response
            done.append(
                response[["iterations", "cuts", "gap_residual", "heat_balance", "pressure"]]
            )
        except ConvergenceError as error:
            failed.append(str(error))
            print(group, case.joints["knee"].friction_coefficient, case.heat_input, error)
    return {group: figures(done, len(failed)) for group, (done, failed) in groups.items()}


HEADER = (
    "coupling",
    "normal law",
    "preload, MPa",
    "marches",
    "failed",
    "steps",
    "iterations a step",
    "most",
    "cuts",
    "worst gap residual, m",
    "worst heat balance",
    "most of the joint open",
)


def rows(coupling: str, found: dict[tuple[str, float], Figures]) -> list[tuple[str, ...]]:
    """Return the table's rows as text."""
    return [
        (
            coupling,
            law,
            f"{preload:g}",
            f"{f.marches}",
            f"{f.failed}",
            f"{f.steps}",
            f"{f.iterations / max(f.steps, 1):.2f}",
            f"{f.most_iterations}",
            f"{f.cuts}",
            f"{f.residual:.1e}",
            f"{f.balance:.1e}",
            f"{100.0 * f.most_open:.0f} %",
        )
        for (law, preload), f in found.items()
    ]


def page(lines: list[tuple[str, ...]]) -> str:
    """Return docs/robustness.md."""
    table = ["| " + " | ".join(line) + " |" for line in (HEADER, ("---",) * len(HEADER), *lines)]
    return "\n".join(
        [
            "# Does the march always converge?",
            "",
            "The reference machine with elements of 100 mm, 35 min at 2 s. Every combination of "
            f"heat input {HEATS[0]:g} to {HEATS[-1]:g} (steps; triangles of 10 min from 3 on), "
            f"friction {FRICTIONS[0]:g} to {FRICTIONS[-1]:g}, preload {PRELOADS[0]:g} to "
            f"{PRELOADS[-1]:g} MPa and both normal laws; with in-step iteration a subset. "
            "A joint may open wholly: that is a result. A contact element counts as open below "
            f"{OPEN_BELOW:g} of its preload. Written by",
            "",
            "```sh",
            "python benchmarks/robustness.py --markdown docs/robustness.md",
            "```",
            "",
            *table,
            "",
            "Iterations are Newton iterations of the gap equations, with all sweeps where the "
            "coupling is iterated; a step that does not converge is cut and, in the end, raised "
            "([march.md](march.md)).",
            "",
        ]
    )


def main() -> int:
    """Sweep, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--markdown", type=Path)
    asked = parser.parse_args()
    found = {coupling: sweep(coupling) for coupling in ("staggered", "iterated")}
    lines = [line for coupling, groups in found.items() for line in rows(coupling, groups)]
    table = Table(*HEADER)
    for line in lines:
        table.add_row(*line)
    Console(width=170).print(table)
    if asked.markdown:
        write_text(asked.markdown, page(lines))
    return int(any(f.failed for groups in found.values() for f in groups.values()))


if __name__ == "__main__":
    raise SystemExit(main())
