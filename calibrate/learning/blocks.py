"""Least squares with a prior and block-wise cross-validation, from sums of products.

A fit needs only the products of features and displacements, summed over blocks. Once it has been
read, a year therefore costs no more than a day, and thousands of structures are compared by solving
small systems. Errors of neighbouring samples are correlated: one sample per hour counts as
independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibrate.learning.rules import Fitting
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True, eq=False)
class Sums:
    """Products of some rows."""

    #: Shape (n, n).
    products: Array
    #: Shape (n,).
    total: Array
    count: int

    @cached_property
    def mean(self) -> Array:
        """Mean of every column, shape (n,)."""
        return self.total / max(self.count, 1)

    @cached_property
    def centred(self) -> Array:
        """Products of the deviations from the mean."""
        return self.products - self.count * np.outer(self.mean, self.mean)

    def less(self, other: Sums) -> Sums:
        """Return the sums without some of the rows."""
        return Sums(
            self.products - other.products, self.total - other.total, self.count - other.count
        )


@dataclass(frozen=True, eq=False)
class Blocks:
    """Rows of a log in blocks of time."""

    #: Of all rows; features first, then displacements.
    whole: Sums
    #: For each block: the rows that are fitted when it is held out, and its own.
    fits: tuple[Sums, ...]
    held: tuple[Sums, ...]
    #: Number of columns that are features.
    features: int
    #: Between rows, s.
    interval: float
    #: Rules of the fit.
    rules: Fitting

    @property
    def penalty(self) -> float:
        """Number of rows that count as one independent sample."""
        return max(self.rules.independent / self.interval, 1.0)

    @cached_property
    def centred(self) -> Array:
        """Centred products of the rows of every fit, the whole last, shape (blocks + 1, n, n)."""
        return np.stack([sums.centred for sums in (*self.fits, self.whole)])

    @cached_property
    def held_products(self) -> Array:
        """Mean products of the rows of every held-out block, shape (blocks, n, n)."""
        return np.stack([own.products / own.count for own in self.held])

    @cached_property
    def means(self) -> Array:
        """Means of every held-out block, and of the rows fitted then, shape (2, blocks, n)."""
        return np.array([[sums.mean for sums in those] for those in (self.held, self.fits)])


def sums_of(rows: Array) -> Sums:
    """Return the sums of rows, shape (k, n)."""
    return Sums(rows.T @ rows, rows.sum(axis=0), len(rows))


def blocks_of(rows: Array, features: int, interval: float, rules: Fitting) -> Blocks:
    """Return rows in blocks of time.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Features in units of their prior, then displacements; in the order of time.
    features : int
        Number of columns that are features.
    interval : float
        Between rows, s.
    rules : Fitting
        Length of a block, and rules of the fit.
    """
    whole = sums_of(rows)
    hours = len(rows) * interval / 3600.0
    count = int(np.clip(hours / rules.hours, rules.fewest, rules.most))
    edges = np.linspace(0, len(rows), count + 1).astype(int)
    margin = int(np.ceil(rules.margin / interval))
    fits = tuple(
        whole.less(sums_of(rows[max(0, first - margin) : end + margin]))
        for first, end in pairwise(edges)
    )
    held = tuple(sums_of(rows[first:end]) for first, end in pairwise(edges))
    return Blocks(whole, fits, held, features, interval, rules)


def weights_of(
    blocks: Blocks, index: Sequence[int] | NDArray[np.int64], priors: Sequence[float]
) -> Array:
    """Return weights for each prior and fit, the whole last: (priors, fits + 1, features, axes).

    Features outside `index` have zero weight. A prior of weight 1 states that a weight is about one
    unit if the error is one unit.
    """
    at = np.asarray(index, dtype=int)
    inner = blocks.centred[:, at[:, None], at]
    outer = blocks.centred[:, at, blocks.features :]
    ridges = np.multiply.outer(priors, blocks.penalty * np.eye(len(at)))
    weights = np.zeros((len(priors), len(inner), blocks.features, outer.shape[-1]))
    weights[:, :, at] = np.linalg.solve(inner + ridges[:, None], outer)
    return weights


def held_out(blocks: Blocks, weights: Array) -> Array:
    """Return the mean square error of every held-out block, (blocks, axes).

    Parameters
    ----------
    blocks : Blocks
        The rows.
    weights : ndarray, shape (blocks, features, axes)
        Of the fit without each block.
    """
    count, n, axes = weights.shape
    used = np.flatnonzero(np.abs(weights).sum(axis=(0, 2)))
    at = np.concatenate((used, np.arange(n, n + axes)))
    # Displacement less estimate as one row of products.
    row = np.concatenate((-weights[:, used], np.broadcast_to(np.eye(axes), (count, axes, axes))), 1)
    square = (row * (blocks.held_products[:, at[:, None], at] @ row)).sum(axis=1)
    own, offset = (blocks.means[:, :, None, at] @ row)[:, :, 0]
    return np.asarray(np.maximum(square - 2.0 * offset * own + offset**2, 0.0))
