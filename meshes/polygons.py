"""Clipping, area and quadrature points of plane convex polygons. Corners are (n, 2), m."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri
from skfem.quadrature import get_quadrature

Polygon = NDArray[np.float64]

#: Exact for the traces of the quadratic elements in use (serendipity quads have cubic terms).
_RULE_POINTS, _RULE_WEIGHTS = get_quadrature(MeshTri.elem.refdom, 4)


def signed_area(corners: Polygon) -> float:
    """Return the area, positive if the corners run anticlockwise (m2)."""
    x, y = corners.T
    following = np.concatenate([corners[1:], corners[:1]])  # np.roll takes several times as long
    return 0.5 * float(x @ following[:, 1] - y @ following[:, 0])


def anticlockwise(corners: Polygon) -> Polygon:
    """Return the same polygon with its corners in anticlockwise order."""
    return corners if signed_area(corners) > 0.0 else corners[::-1]


def clip(subject: Polygon, window: Polygon) -> Polygon:
    """Intersect two convex anticlockwise polygons (Sutherland & Hodgman 1974).

    Returns
    -------
    ndarray, shape (n, 2)
        The intersection; empty (0, 2) if there is none.
    """
    result = subject
    for start, end in zip(window, np.concatenate([window[1:], window[:1]]), strict=True):
        if len(result) == 0:
            break
        edge = end - start
        side = edge[0] * (result[:, 1] - start[1]) - edge[1] * (result[:, 0] - start[0])
        kept: list[NDArray[np.float64]] = []
        for i in range(len(result)):
            here, there = result[i - 1], result[i]
            a, b = side[i - 1], side[i]
            if (a < 0.0) != (b < 0.0):
                kept.append(here + (there - here) * (a / (a - b)))
            if b >= 0.0:
                kept.append(there)
        result = np.array(kept).reshape(-1, 2)
    return result


def quadrature(corners: Polygon) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quadrature points (n, 2) and weights (n,) of a convex polygon, weights summing to its area.

    The polygon is divided into a fan of triangles with a rule of degree four on each.
    """
    origin = corners[0]
    first, second = corners[1:-1] - origin, corners[2:] - origin
    double_area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    points = (
        origin
        + _RULE_POINTS[0][None, :, None] * first[:, None, :]
        + _RULE_POINTS[1][None, :, None] * second[:, None, :]
    )
    weights = double_area[:, None] * _RULE_WEIGHTS[None, :]
    return points.reshape(-1, 2), weights.ravel()
