"""Camera of a picture: a parallel projection and its window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array

Vector = tuple[float, float, float]
#: Left, right, bottom and top of a picture in the plane of projection, m.
Window = tuple[float, float, float, float]

#: Smallest and largest width over height of a window.
_NARROWEST, _WIDEST = 0.6, 1.7
#: Margin around the contents of a window, relative to its larger side.
_MARGIN = 0.03


@dataclass(frozen=True)
class Camera:
    """A parallel projection."""

    #: Direction from the object towards the eye, of any length.
    view: Vector
    #: Upward direction of the picture, as far as compatible with `view`.
    up: Vector

    @property
    def basis(self) -> Array:
        """Unit vectors to the right, upwards and towards the eye, shape (3, 3), by rows."""
        towards = np.asarray(self.view) / np.linalg.norm(self.view)
        right = np.cross(self.up, towards)
        if np.linalg.norm(right) < 1e-6 * np.linalg.norm(self.up):
            right = np.cross(np.eye(3)[np.abs(towards).argmin()], towards)
        right /= np.linalg.norm(right)
        above = np.cross(towards, right)
        # Seen from above, the small remaining component of `up` defines the upward direction.
        side = -1.0 if above @ np.asarray(self.up) < 0.0 else 1.0
        return np.array([side * right, side * above, towards])

    def project(self, points: Array) -> Array:
        """Components of `points` (n, 3) to the right, upwards and towards the eye, m."""
        return np.asarray(points @ self.basis.T)


def facing(main: Array, up: Vector, side: float, height: float) -> Vector:
    """View along `main`, from `side` of its length to the right of it and `height` above it."""
    front = main / np.linalg.norm(main)
    right, above, _ = Camera((float(front[0]), float(front[1]), float(front[2])), up).basis
    view = front + side * right + height * above
    return float(view[0]), float(view[1]), float(view[2])


def window_around(projected: Array) -> Window:
    """Window of `projected` points (n, 2 or 3), m, with a margin and a limited aspect ratio."""
    low, high = projected[:, :2].min(axis=0), projected[:, :2].max(axis=0)
    size = np.maximum(high - low, 1e-9)
    size += 2.0 * _MARGIN * size.max()
    size = np.maximum(size, [_NARROWEST * size[1], size[0] / _WIDEST])
    (left, bottom), (right, top) = 0.5 * (low + high - size), 0.5 * (low + high + size)
    return float(left), float(right), float(bottom), float(top)
