"""A machine whose axes move while the estimator does not read their positions."""

from typing import NamedTuple

import numpy as np
from observed import estimates
from structured_text import called

from estimator.interface import Status
from estimator.lines import here
from thermojoint.reduced.physics import simulate_known


class Followed(NamedTuple):
    """What an estimator says of a run, m."""

    #: Shape (samples, axes): where the axes are, and its band.
    here: np.ndarray
    band_here: np.ndarray
    #: Shape (samples, axes): as a control is given it, and its band.
    given: np.ndarray
    band: np.ndarray
    unsettled: np.ndarray


def course(estimator, count, unread):
    """Positions (samples, x): at one end; elsewhere while they are not read, and from then on.

    The first axis goes to and fro at its fastest, and the others stand after they have moved.
    """
    strokes = [one[[0, -1]] for one in estimator.model.modes.way.stations.positions]
    found, step = np.empty((count, len(strokes))), estimator.model.step
    for k, (low, high) in enumerate(strokes):
        gone = estimator.model.calibrated.speeds[k] * step * np.arange(count)
        around = np.abs(np.mod(gone, 1.2 * (high - low)) - 0.6 * (high - low))
        found[:, k] = low + 0.4 * (high - low) + around if k == 0 else high
        found[: unread.start, k] = low
    return found


def rows_of(estimator, positions, level):
    """Samples of the machine itself, with noise; the odometers count what positions show."""
    model, rng = estimator.model, np.random.default_rng(1)
    gone = np.abs(np.diff(positions, axis=0, prepend=positions[:1]))
    heat = np.full((len(positions), model.power.size), level * model.calibrated.heat) * model.power
    inputs = np.column_stack([heat, np.zeros(len(positions)), positions])
    read, _ = simulate_known(estimator.observer.physics, inputs, model.step, gone)
    read = read + 0.02 * rng.standard_normal(read.shape)
    odometers = np.cumsum(gone, axis=0)[:, list(model.counted)]
    times = model.step * np.arange(len(positions))
    return np.column_stack([times, read, np.zeros(len(positions)), positions, odometers])


def without_positions(estimator, rows, unread, axes):
    """The samples without the positions of some axes in a slice of them."""
    found = rows.copy()
    first = 1 + len(estimator.model.sensors) + 1
    found[unread, [[first + k] for k in axes]] = np.nan
    return found


def followed(estimator, rows):
    _, found = estimates(estimator, rows.tolist())
    moved, band_here = here(estimator.axes, estimator.details, found)
    return Followed(
        moved,
        band_here,
        np.array([one.displacement for one in found]),
        np.array([one.band for one in found]),
        np.array([Status.UNSETTLED in one.status for one in found]),
    )


def assert_held(estimator, unread, axes, level=0.8, after=120):
    """The bands hold what the axes have done meanwhile, and afterwards, and say so."""
    rows = rows_of(estimator, course(estimator, unread.stop + after, unread), level)
    whole = followed(estimator, rows)
    found = followed(estimator, without_positions(estimator, rows, unread, axes))
    for phase in (unread, slice(unread.stop, unread.stop + 20), slice(unread.stop + 20, None)):
        assert (np.abs(found.here - whole.here) <= found.band_here)[phase].mean() >= 0.95
        assert (np.abs(found.given - whole.given) <= found.band)[phase].mean() >= 0.95
    assert np.array_equal(found.band[: unread.start], whole.band[: unread.start])
    assert not found.unsettled[: unread.start].any()
    # It would not have been in the band of known positions.
    assert (np.abs(found.here - whole.here) > whole.band_here)[unread].any()
    assert found.unsettled[(found.band > 2.0 * whole.band).any(axis=1)].all()
    assert (found.band_here >= found.band).all()


def assert_held_after_a_gap(estimator, gone, level=0.8, after=60):
    """The band holds what the axes have done while there were no samples."""
    rows = rows_of(estimator, course(estimator, gone.stop + after, gone), level)
    whole = followed(estimator, rows)
    found = followed(estimator, np.delete(rows, np.arange(gone.start, gone.stop), axis=0))
    error = np.abs(found.here[gone.start :] - whole.here[gone.stop :])
    assert (error <= found.band_here[gone.start :]).mean() >= 0.95
    assert found.unsettled[gone.start]
    assert (error > whole.band_here[gone.stop :]).any()


def assert_function_block(program, estimator, rows, folder):
    """A function block gives the displacement, the bands and the status of Python."""
    names = [f"reading_{one.name}" for one in program.interface.inputs]
    given = np.nan_to_num(rows[:, 1:], nan=-1e9).tolist()
    calls = [dict(zip(names, row, strict=True)) for row in given]
    found, expected = called(program, folder, calls), followed(estimator, rows)
    for k, axis in enumerate(program.interface.axes):
        for name, values, within in (
            ("displacement", expected.given, 1e-9),
            ("band", expected.band, 1e-5 * expected.band.max()),
            ("here_band", expected.band_here, 1e-5 * expected.band_here.max()),
        ):
            got = [one[f"{name}_{axis}"] for one in found]
            np.testing.assert_allclose(got, values[:, k], rtol=0.0, atol=within)
    unsettled = [bool(one["status"] & Status.UNSETTLED) for one in found]
    np.testing.assert_array_equal(unsettled, expected.unsettled)
