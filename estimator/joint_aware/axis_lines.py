"""Lines of the displacement along the moving axes, as a control is given them."""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.observer import Observer
from estimator.joint_aware.sample_processing import Processed
from fesim.axes.line import line_over
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MILLI


def lines_along(
    observer: Observer, processed: Processed, error: Array, band: Array
) -> tuple[Array, Array]:
    """Return the displacement (axes,), m, and the details of lines (`channels.estimate_details`).

    The displacement is K0 where a control is given the line, else that at the present position.
    The band (axes,) holds at every position, and so bounds the error of a slope by its ends.
    `error` (axes,) is the estimated model error, m.
    """
    model, asked = observer.model, _asked(observer, processed, error)
    along = [
        line_over(axis.asked, own, axis.reference)
        for axis, own in zip(model.moving_axes, asked, strict=True)
    ]
    here, details = processed.displacement + error, list[float]()
    moved = here.copy()
    for axis, stroke in model.strokes.items():
        c, k = model.axes.index(axis), model.sloped[axis]
        moved[c], half = along[k].offset[c], float(band[c])
        details += [along[k].slope[c], 2.0 * half / (stroke.high - stroke.low)]
        details += [*(np.array(stroke) / MILLI), here[c], half, *asked[k][:, c].tolist()]
    if len(along) > 1:
        each = [np.stack([line.offset, line.slope], axis=1) for line in along]
        details += np.stack(each, axis=1).ravel().tolist()
    return moved, np.array(details)


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
