"""Lines of the displacement along the moving axes, as a control is given them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer import Observer
from estimator.joint_aware.sample_processing import Processed
from fesim.axes.line import line_over
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.units import MILLI


class Lines(NamedTuple):
    """Displacement of a machine with axes, its band, and the details of its lines."""

    #: Shape (axes,): K0 where a control is given the line, else at the present position, m.
    displacement: Array
    #: Shape (axes,): half-width, m; it holds at every position of the axis of the line.
    band: Array
    #: Shape (axes,): half-width at the present position, m.
    band_here: Array
    #: `channels.estimate_details`.
    details: Array


def lines_along(
    observer: Observer, processed: Processed, error: Array, band: Array, missing: Flags
) -> Lines:
    """Return the displacement with its lines.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    processed : Processed
        The sample.
    error : ndarray, shape (axes,)
        Estimated model error, m.
    band : ndarray, shape (axes,)
        Half-width where all positions are known, m. It holds at every position, and so bounds the
        error of a slope by its ends.
    missing : ndarray of bool, shape (x,)
        Positions that are missing.
    """
    model, asked = observer.model, _asked(observer, processed, error)
    along = [
        line_over(axis.asked, own, axis.reference)
        for axis, own in zip(model.moving_axes, asked, strict=True)
    ]
    here, details = processed.displacement + error, list[float]()
    moved, unplaced = here.copy(), of_missing_positions(asked, here, missing)
    band_here = band + unplaced.sum(axis=0)
    band = band_here.copy()
    for axis, stroke in model.strokes.items():
        c, k = model.axes.index(axis), model.sloped[axis]
        # A line along the axis does not depend on where the axis is.
        moved[c], half = along[k].offset[c], float(band_here[c] - unplaced[k, c])
        band[c] = half
        details += [along[k].slope[c], 2.0 * half / (stroke.high - stroke.low)]
        details += [*(np.array(stroke) / MILLI), here[c], band_here[c], *asked[k][:, c].tolist()]
    if len(along) > 1:
        each = [np.stack([line.offset, line.slope], axis=1) for line in along]
        details += np.stack(each, axis=1).ravel().tolist()
    return Lines(moved, band, band_here, np.array(details))


def of_missing_positions(asked: list[Array], here: Array, missing: Flags) -> Array:
    """Return by how much the displacement may differ as axes are not where they are assumed, m.

    Shape (x, axes): for every axis whose position is missing the largest difference to any position
    that is evaluated along it, `asked` (k, axes), zero for the others.
    """
    most = [np.abs(places - here).max(axis=0) for places in asked]
    return np.array(most) * missing[:, None]


def _asked(observer: Observer, processed: Processed, error: Array) -> list[Array]:
    """Displacements (k, axes), m, along each moving axis, the others at their positions."""
    after, moving, places = processed.after, observer.model.moving_axes, list[Array]()
    for k, axis in enumerate(moving):
        places.append(np.tile(observer.place(after.loads), (axis.asked.size, 1)))
        places[k][:, k] = axis.asked
    every = np.vstack(places)
    asked = error + observer.seen_from(after, processed.slip_knowledge, every)
    ends = np.cumsum([axis.asked.size for axis in moving])[:-1]
    return np.split(asked, ends)
