"""Whether a band holds on calibration runs that the calibration has not seen.

Each run is left out in turn; the others give a fit, a posterior and an observer of their own. The
errors of this observer in the run that was left out, relative to those that the posterior expects,
tell how far the machine differs from its model by more than parameters. The band is widened until
it would have held on every run: split conformal prediction, with runs as blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.misfit import Run, coarser, make_problem
from calibrate.joint_aware.open_band import (
    HEALTHY,
    Drawing,
    draw_machines,
    errors_on,
    history_of,
    shortfall,
)
from calibrate.joint_aware.physics_fit import SEARCH, Fit, refit
from estimator.interface import follow
from estimator.joint_aware.estimator import WIDTH, JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Band, ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.machine import ReducedMachine

#: Share of the samples of a run that the band has to hold. Errors last, so that it is nearly all;
#: but readings of a long run are too far apart for the moments after a change of the heat.
HELD = 0.98
#: Sizes of a variance that are tried, relative to the mean square of what was missed.
SIZES = (0.0, *np.geomspace(0.1, 100.0, 31))


def widened(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    model: ObserverModel,
    noise: Noise | None,
    drawing: Drawing,
) -> Band:
    """Return the band of a model, wide enough to hold on every run that is left out.

    Parameters
    ----------
    machine : ReducedMachine
        As its case says.
    runs : sequence of Run
        Calibration runs. A single one leaves the band as it is.
    fit : Fit
        Of all runs.
    model : ObserverModel
        With the band of that fit's posterior (`open_band`).
    noise : Noise, optional
        As for `make_observer`.
    drawing : Drawing
        Number of machines drawn.
    """
    slow = replace(machine, step=max(drawing.step, machine.step))
    unseen = []
    for k, run in enumerate(runs if len(runs) > 1 else ()):
        others = [*runs[:k], *runs[k + 1 :]]
        try:
            fitted = refit(machine, others, fit)
            unseen.append(_unseen(slow, run, _Others(others, fitted, noise), model, drawing))
        except ConvergenceError:
            continue
    if not unseen:
        return model.band
    more = [_missing(unseen, axis, drawing.floor) for axis in range(len(machine.axes))]
    return replace(model.band, square=model.band.square + np.array(more))


class _Others(NamedTuple):
    """The runs that are kept, their fit, and the noise of its observer."""

    runs: Sequence[Run]
    fit: Fit
    noise: Noise | None


class _Unseen(NamedTuple):
    """A run that was left out: squares of the relaxed heat (n, q), expected variances and errors.

    Variances (n, axes) are in m2, errors (n, axes) in m.
    """

    squares: Array
    expected: Array
    errors: Array


def _missing(unseen: Sequence[_Unseen], axis: int, floor: float) -> Array:
    """Least coefficients (q,) of the squares with which the band of an axis holds on every run."""
    squares, expected, errors = (np.concatenate(parts) for parts in zip(*unseen, strict=True))
    shape = shortfall(squares, expected[:, axis], errors[None, :, axis], floor)

    def holds(size: float) -> bool:
        return all(
            np.quantile(
                np.abs(run.errors[:, axis])
                / np.sqrt(run.expected[:, axis] + size * (run.squares @ shape)),
                HELD,
            )
            <= WIDTH
            for run in unseen
        )

    return next((size * shape for size in SIZES if holds(size)), SIZES[-1] * shape)


def _unseen(
    slow: ReducedMachine, run: Run, others: _Others, model: ObserverModel, drawing: Drawing
) -> _Unseen:
    """Errors in a run that was left out, and what the posterior of the others expects."""
    fit = others.fit
    filtered = make_observer(slow, fit, model.calibrated, others.noise)
    observer = JointAware(filtered, thresholds=HEALTHY)
    whole = coarser(run, max(2, round(run.length * len(run.inputs) / slow.step)))
    grid = whole.length * np.arange(len(whole.inputs) + 1)

    def at_steps(values: Array) -> Array:
        return np.column_stack([np.interp(grid, run.times, column) for column in values.T])

    ambient = np.append(0.0, whole.inputs[:, -1])
    readings = np.column_stack([grid, at_steps(run.temperature), ambient])
    estimates = follow(observer, map(tuple, readings), observer.initial_state())
    found = np.array([estimate.displacement for _, estimate in estimates])
    errors = (found - at_steps(run.displacement))[1:]
    problem = make_problem(slow, [coarser(one, SEARCH.steps) for one in others.runs])
    heat = whole.inputs[:, :-1] / slow.power
    history = history_of(heat, fit.discrepancy.rates, slow.step)
    rng = np.random.default_rng(drawing.seed)
    drawn = [
        errors_on(slow, one, observer, history) for one in draw_machines(rng, problem, fit, drawing)
    ]
    expected = filtered.band.steady + filtered.band.constant + np.mean(np.square(drawn), axis=0)
    # What lasts for longer than the run is not told by it.
    told = fit.discrepancy.rates * grid[-1] >= 1.0
    return _Unseen(history.squares * told, expected, errors)
