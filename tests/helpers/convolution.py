"""The inverse filter by convolution: Eqs. 5 and 6 taken literally, as the reference for the tests.

The kernel is the numerical inverse Laplace transform of the exact transfer function (hyperbolic
contour, Weideman & Trefethen, Math. Comp. 76, 2007), so nothing is shared with the rational
approximation. G grows as s/A and its kernel is a distribution; Eq. 5 is therefore integrated by
parts. For samples joined by straight lines, with slope changes Δm_k at t_k,

    ∫_0^t Q dτ = slope · ΔT(t) + Σ_k k3(t - t_k) Δm_k,   k3(s) = (G(s)/s - slope) / s²,

whose differences give the mean heat of each interval. It costs O(n²) and is not meant for streams.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.models.filters.inverse import regularised_transfer
from thermojoint.models.filters.pole_residue import Transfer
from thermojoint.models.parameters import Regularisation, RingModel

#: Singularities may lie within this angle of the negative real axis, rad; the contour's own
#: angle is half way from there to the vertical.
_SECTOR = 1.2
_ANGLE = 0.5 * (np.pi / 2.0 - _SECTOR)
#: Vertex of the hyperbola times t, and the nodes of two rules that are compared for the error.
_VERTEX = 4.0
_NODES = 140
_CHECK_NODES = 115
_REACH = 4.6


def invert_laplace(transform: Transfer, times: np.ndarray, nodes: int = _NODES) -> np.ndarray:
    """Return the original of `transform` at positive `times`: trapezoidal rule on a hyperbola.

    s(u) = (4/t) (1 + sin(iu - angle)), nodes at u = (k + 1/2) h and their mirror images. The
    transform, (k,) to (k, ...), is real on the real axis and singular only within `_SECTOR` of
    the negative one.
    """
    spacing = _REACH / nodes
    along = 1j * (np.arange(nodes) + 0.5) * spacing - _ANGLE
    contour = _VERTEX * (1.0 + np.sin(along))
    weight = np.exp(contour) * _VERTEX * np.cos(along) * (spacing / np.pi)
    s = contour / np.asarray(times)[:, None]
    values = np.asarray(transform(s.ravel()))
    values = values.reshape(*s.shape, *values.shape[1:])
    total = np.tensordot(weight, values, axes=(0, 1)).real
    return np.asarray(total / np.asarray(times).reshape(-1, *[1] * (total.ndim - 1)))


def heat_by_convolution(
    rings: Sequence[Sequence[RingModel]],
    regularisations: Sequence[Regularisation],
    times: np.ndarray,
    temperatures: np.ndarray,
    lead: float,
    accuracy: float = 1e-8,
) -> np.ndarray:
    """Return the mean heat (k, n) of each interval by Eq. 5.

    Temperatures (k, n), joined by straight lines, were zero until `lead` seconds before the first;
    two orders of the inversion differ by less than `accuracy` of the kernel's largest value.
    """
    transfer = regularised_transfer(rings, regularisations)
    slope = np.diag([1.0 / f.A for f in regularisations])

    def kernel(s: np.ndarray) -> np.ndarray:
        at = s[:, None, None]
        return np.asarray((np.linalg.inv(transfer(s)) / at - slope) / at**2)

    knots = np.concatenate(([times[0] - lead], times))
    values = np.concatenate((np.zeros((1, temperatures.shape[1])), temperatures))
    slopes = np.diff(values, axis=0) / np.diff(knots)[:, None]
    changes = np.diff(slopes, axis=0, prepend=0.0)
    lags = np.subtract.outer(knots, knots[:-1])
    earlier = lags > 0.0
    distinct, place = np.unique(lags[earlier], return_inverse=True)
    response = invert_laplace(kernel, distinct, _NODES)
    difference = np.abs(response - invert_laplace(kernel, distinct, _CHECK_NODES)).max()
    if difference > accuracy * np.abs(response).max():
        raise ConvergenceError(
            f"inverse Laplace transform: two orders differ by {difference:.2g} of "
            f"{np.abs(response).max():.2g}; the transfer function has poles off the contour"
        )
    table = np.zeros((*lags.shape, *slope.shape))
    table[earlier] = response[place]
    heat = values @ slope.T + np.einsum("tkij,kj->ti", table, changes)
    return np.asarray(np.diff(heat, axis=0) / np.diff(knots)[:, None])
