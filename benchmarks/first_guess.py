"""Iterations and time of a step by the order to which gaps are extrapolated.

On the reference machine with 27 or more contact elements, for heat that is constant or changes.
Run: ``python -m benchmarks.first_guess``; ``--grid 24 8`` takes 192 contact elements.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import process_time

import numpy as np

from benchmarks.performance.cases import reference_case, with_contacts
from benchmarks.performance.marching import driven
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import at_rest
from fesim.march.stepping import march_along, staggered
from fesim.march.track import joined
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array

ORDERS, REPEATS, STEPS = (1, 2, 3, 4), 3, 1050


def histories(times: Array) -> dict[str, Array]:
    """Factors of the heat at times (n,), s, by the name of the history."""
    noise = np.random.default_rng(0).standard_normal(times.size)
    return {
        "constant": np.ones(times.size),
        "on and off every 150 s": np.where(times // 150.0 % 2.0 == 0.0, 1.0, 0.2),
        "a sine of 6 min": 0.5 + 0.5 * np.sin(2.0 * np.pi * times / 360.0),
        "noise of 30 %": 1.0 + 0.3 * noise,
    }


def measured(machine: CondensedMachine, inputs: Array, start: State) -> tuple[float, float]:
    """Mean iterations of a step, and its processor time, s."""
    begun = process_time()
    track = joined(list(march_along(machine, inputs, staggered, start)))
    return float(track.iterations.mean()), (process_time() - begun) / len(track)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--grid", nargs=2, type=int, metavar=("ALONG", "ACROSS"))
    parser.add_argument("--steps", type=int, default=STEPS)
    asked = parser.parse_args()
    case = reference_case() if asked.grid is None else with_contacts(reference_case(), *asked.grid)
    machine, inputs = set_up(case).machine, driven(case)[: asked.steps + 1]
    start = at_rest(machine, inputs[0]).state
    size = start.differences.shape[1]
    print("| heat | " + " | ".join(f"order {order}" for order in ORDERS) + " |")
    for name, factors in histories(case.march.step_s * np.arange(1.0, len(inputs))).items():
        heat = factors[:, None] * inputs[1:]
        found = {order: list[tuple[float, float]]() for order in ORDERS}
        for _ in range(REPEATS):  # in turn: a computer is not always as fast
            for order, runs in found.items():
                guessed = replace(start, differences=np.zeros((order, size)))
                runs.append(measured(machine, heat, guessed))
        cells = [
            f"{runs[0][0]:.2f}, {1e6 * min(time for _, time in runs):.0f} µs"
            for runs in found.values()
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
