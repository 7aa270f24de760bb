"""Check of a band on calibration runs that are left out of the calibration.

Each run is left out in turn; the others give a fit, a posterior and an observer of their own. The
errors of this observer in the run that was left out, relative to those that the posterior expects,
show how far the machine deviates from its model beyond the parameters. The band is widened until it
would have held on every run: split conformal prediction, with runs as blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibrate.joint_aware.assembling import observer_from_rest
from calibrate.joint_aware.misfit import Run, counted_in, fewer, highest_heat, joined, sampled
from calibrate.joint_aware.open_band import (
    Drawing,
    drawn_errors,
    history_of,
    on_longer_steps,
    shortfall,
    unlike_its_case,
)
from calibrate.joint_aware.physics_fit import Fit, refit
from estimator.joint_aware.band import WIDTH
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Band, ObserverModel
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.discrepancy import REACH, told_by
from thermojoint.reduced.machine import ReducedMachine

#: Share of the samples of a run that the band has to contain; nearly all, as errors persist.
HELD = 0.98
#: Trial sizes of an additional variance, relative to the mean square shortfall.
SIZES = (0.0, *np.geomspace(0.1, 100.0, 31))


def widened(
    machine: ReducedMachine,
    runs: Sequence[Run],
    fit: Fit,
    model: ObserverModel,
    noise: Noise,
    drawing: Drawing,
) -> tuple[Band, list[int]]:
    """Return the band of a model, wide enough to hold on every run that is left out.

    Also the indices of runs on which it was not checked: the others have no fit or no heat, their
    machine cannot be marched, or the run alone shows slow errors (`_alone`).

    Parameters
    ----------
    machine : ReducedMachine
        As described by its case.
    runs : sequence of Run
        Calibration runs with all their samples. With a single one the band is not changed.
    fit : Fit
        Of all runs, with the samples that `fewer` keeps.
    model : ObserverModel
        With the band of that fit's posterior (`open_band`).
    noise : Noise
        As for `observer_from_rest`.
    drawing : Drawing
        Number of machines drawn.
    """
    unseen, unchecked = list[_Unseen](), list[int]()
    thinned = [fewer(run) for run in runs]
    for k, run in enumerate(runs if len(runs) > 1 else ()):
        others = [*thinned[:k], *thinned[k + 1 :]]
        if (fit.doubt > 1.0 and _alone(runs, k)) or not highest_heat(machine, others):
            unchecked.append(k)
            continue
        try:
            fitted = refit(machine, thinned, fit, k)
            left = _Others(others, fitted, noise)
            unseen.append(_unseen(machine, run, left, model, drawing))
        except ConvergenceError:
            unchecked.append(k)
    if not unseen:
        return model.band, unchecked
    more = [_missing(unseen, axis, drawing.floor) for axis in range(len(machine.axes))]
    return replace(model.band, square=model.band.square + np.array(more)), unchecked


def _alone(runs: Sequence[Run], k: int) -> bool:
    """Whether a run is so long that none of the others, at least one, shows its slow errors.

    On a machine unlike its case a fit without it attributes them to films and heat: the errors of
    that fit in this run are not those of the fit with it.
    """
    lengths = [run.length * len(run.inputs) for run in runs]
    return lengths[k] > REACH * max(lengths[:k] + lengths[k + 1 :])


class _Others(NamedTuple):
    """The runs that are kept, their fit, and the noise of its observer."""

    runs: Sequence[Run]
    fit: Fit
    noise: Noise


class _Unseen(NamedTuple):
    """A run that was left out: squares of the relaxed heat (n, q), expected variances and errors.

    Variances (n, axes) are in m2, errors (n, axes) in m, NaN where the displacement was not read.
    """

    squares: Array
    expected: Array
    errors: Array

    def along(self, axis: int) -> _Unseen:
        """Return the rows in which the displacement along an axis was read."""
        read = np.isfinite(self.errors[:, axis])
        return _Unseen(self.squares[read], self.expected[read, axis], self.errors[read, axis])


def _missing(unseen: Sequence[_Unseen], axis: int, floor: float) -> Array:
    """Least coefficients (q,) of the squares with which the band of an axis holds on every run."""
    every = [run.along(axis) for run in unseen]
    squares, expected, errors = (np.concatenate(parts) for parts in zip(*every, strict=True))
    shape = shortfall(squares, expected, errors[None], floor)

    def holds(size: float) -> bool:
        return all(
            np.quantile(
                np.abs(one.errors) / np.sqrt(one.expected + size * (one.squares @ shape)), HELD
            )
            <= WIDTH
            for one in every
        )

    return next((size * shape for size in SIZES if holds(size)), SIZES[-1] * shape)


def _unseen(
    machine: ReducedMachine, run: Run, others: _Others, model: ObserverModel, drawing: Drawing
) -> _Unseen:
    """Errors in a run that was left out, and the variances that the others' posterior expects."""
    fit = others.fit
    filtered = observer_from_rest(machine, fit, model.calibrated, others.noise)
    observer, sources = JointAware(filtered), machine.power.size
    moving = len(machine.axis_names)
    given = samples_of(run, sources + len(machine.held.names))
    found = observer.displacements(np.hstack([given, counted_in(run, filtered.counted)]))
    # The expected variances, on the longer steps of the band.
    slow = on_longer_steps(machine, others.runs, model.calibrated, fit, others.noise, drawing)
    step = slow.machine.step
    steps = joined(run, max(1, round(step / run.length)))
    grid = steps.length * np.arange(1.0, len(steps.inputs) + 1.0)
    # Means over these steps: noise of the displacement readings is not an error of the estimate.
    errors, read = means_in(-run.beyond(found), run.times, grid)
    driven, course = steps.inputs[:, :sources], steps.inputs[:, steps.inputs.shape[1] - moving :]
    history = history_of(driven / machine.power, fit.discrepancy.rates, step, course)
    drawn = drawn_errors(np.random.default_rng(drawing.seed), slow, [history], drawing)
    expected = filtered.band.steady + filtered.band.constant + np.mean(np.square(drawn), axis=0)
    expected = expected + history.squares @ unlike_its_case(slow).T
    # Only relaxations of which the run shows at least the beginning.
    told = told_by(fit.discrepancy.rates, grid[-1]) > 0.0
    return _Unseen((history.squares * told)[read], expected[read], errors)


def means_in(values: Array, times: Array, grid: Array) -> tuple[Array, Flags]:
    """Return means of values (n, c) at `times` (n,) in steps of `grid`, and the steps with any.

    Steps without any sample are left out of the means; NaN is no value, and the mean of none.
    """
    step = np.searchsorted(grid * (1.0 + 1e-9), times)[:, None] == np.arange(grid.size)
    read, there = step.any(axis=0), np.isfinite(values)
    count = (step.T @ there.astype(float))[read]
    means = np.full(count.shape, np.nan)
    sums = (step.T @ np.where(there, values, 0.0))[read]
    return np.divide(sums, count, out=means, where=count > 0.0), read


def samples_of(run: Run, driven: int) -> Array:
    """Return times and readings of a run, with the inputs after the first `driven`.

    The latter are the ambient and the loads.
    """
    steps = run.inputs[:, driven:]
    first = steps[0].copy()
    if run.loads is not None:
        first[1 : 1 + run.loads.size] = run.loads
    given = sampled(steps, run, first)
    return np.column_stack([run.times, run.temperature, given])
