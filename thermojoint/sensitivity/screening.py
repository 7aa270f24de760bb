"""Effects over whole ranges: Morris screening and Sobol indices (SALib)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fesim.batch.study import RangeSection, Values, values_in
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.sensitivity.measures import INDICES, STILL, Method

#: Levels of the grid of Morris's trajectories.
LEVELS = 4
#: Fractions of the samples whose indices show the convergence.
SHARES = (0.25, 0.5, 1.0)


@dataclass(frozen=True)
class Design:
    """Samples of the ranges."""

    #: ``"morris"`` or ``"sobol"``.
    method: Method
    ranges: tuple[RangeSection, ...]
    #: Shape (samples, ranges): samples in the unit cube.
    unit: Array
    #: Seed of the samples and of the confidence intervals.
    seed: int

    @property
    def block(self) -> int:
        """Number of samples per block: a trajectory, or a base sample and its combinations."""
        return len(self.ranges) + (1 if self.method == "morris" else 2)

    @property
    def rows(self) -> list[Values]:
        """Values of the cases."""
        return values_in(self.ranges, self.unit)


def design_of(ranges: Sequence[RangeSection], method: Method, count: int, seed: int) -> Design:
    """Return `count` trajectories of Morris, or a base of `count` samples for Sobol's indices.

    Raises
    ------
    InputError
        The count is too small, or for Sobol's indices not a power of two.
    """
    problem = _problem(len(ranges))
    if count < 4:
        raise InputError(f"--samples {count}: give 4 or more")
    if method == "morris":
        from SALib.sample.morris import sample

        unit = sample(problem, count, num_levels=LEVELS, seed=seed)
    else:
        if count & (count - 1):
            raise InputError(f"--samples {count}: Sobol's sequence needs a power of two")
        from SALib.sample.sobol import sample

        unit = sample(problem, count, calc_second_order=False, seed=seed)
    return Design(method, tuple(ranges), np.asarray(unit, dtype=np.float64), seed)


def indices_of(design: Design, figure: Array) -> list[dict[str, Any]]:
    """Return the indices from the first quarter, half and all of the samples.

    Parameters
    ----------
    design : Design
        The samples.
    figure : ndarray, shape (samples,)
        Results of the cases.

    Returns
    -------
    list of dict
        ``samples``, and each of `INDICES` as a list with one value for each range.
    """
    blocks = len(figure) // design.block
    return [
        _indices(design, figure[: design.block * max(2, int(share * blocks))]) for share in SHARES
    ]


def _indices(design: Design, figure: Array) -> dict[str, Any]:
    problem = _problem(len(design.ranges))
    if np.ptp(figure) <= STILL:
        none = [0.0] * len(design.ranges)
        return {"samples": len(figure)} | dict.fromkeys(INDICES[design.method], none)
    if design.method == "morris":
        from SALib.analyze.morris import analyze

        # Per third of the range: a step of Morris's grid is two thirds of the range.
        result = analyze(
            problem, design.unit[: len(figure)], figure / 3.0, num_levels=LEVELS, seed=design.seed
        )
    else:
        from SALib.analyze.sobol import analyze

        result = analyze(problem, figure, calc_second_order=False, seed=design.seed)
    values = {name: np.asarray(result[name], dtype=np.float64) for name in INDICES[design.method]}
    return {"samples": len(figure)} | {name: value.tolist() for name, value in values.items()}


def _problem(count: int) -> dict[str, Any]:
    return {
        "num_vars": count,
        "names": [f"x{number}" for number in range(count)],
        "bounds": [[0.0, 1.0]] * count,
    }
