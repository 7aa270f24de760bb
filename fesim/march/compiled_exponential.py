"""JIT-compiled weights of exponential steps (`fesim.march.exponential`).

After a fraction of a step of length h the unknowns are E a + A f0 + B (f1 - f0), where a are those
at its start, and f0 and f1 the forcing at its start and end: the heat of a mode, or the temperature
of a held surface, so that the same form of weights serves both. The weights of the last few lengths
are kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled_part
from fesim.march.exponential import NEAR, TERMS
from thermojoint.artefacts.arrays import Array

#: Fractions of a step at which its pieces end: the whole step, and half of it.
SHARES = (1.0, 0.5)
#: Rows of the weights of a length: E, A, B of each fraction; of the mean over the step; of the
#: effect of a curvature of the flows.
STAYS, STARTS, TURNS = range(3)
MEAN, BENDS = 3 * len(SHARES), 3 * len(SHARES) + 3
#: Maximum and minimum number of kept lengths, and maximum total size of their weights.
MOST, FEWEST, NUMBERS = 124, 4, 4_000_000


class Modes(NamedTuple):
    """Heat equation on n unknowns: modes, then held surfaces."""

    #: Shape (n,): decay rates of the modes, 1/s; infinite for held surfaces.
    rates: Array
    #: Shape (n, k): heat of each mode per unit of each input, and temperature of each held surface.
    inputs: Array
    #: Shape (n, m): heat that each joint heat flow takes from a mode; zero for held surfaces.
    drawn: Array


class Lengths(NamedTuple):
    """Weights of the most recent step lengths; written in place."""

    #: Shape (q,): lengths, s; zero for an empty place.
    length: Array
    #: Shape (q, 10, n): rows as above.
    weights: Array
    #: Shape (q, m, m): temperature jumps per W across each contact element at the end of the step,
    #: K/W.
    influence: Array
    #: Shape (1,): place for the next length.
    next: NDArray[np.int64]
    #: Shape (n, m): work array.
    storage: Array


def new_lengths(modes: Modes) -> Lengths:
    """Return storage without any length."""
    size, count = modes.drawn.shape
    rows = BENDS + 1
    kept = min(max(NUMBERS // (rows * size + count * count + 1), FEWEST), MOST)
    return Lengths(
        np.zeros(kept),
        np.empty((kept, rows, size)),
        np.empty((kept, count, count)),
        np.zeros(1, dtype=np.int64),
        np.empty((size, count)),
    )


@compiled_part
def phi(decay: float) -> tuple[float, float, float]:
    """phi_1, phi_2, phi_3 of -`decay`, as `fesim.march.exponential.phi_functions`."""
    if decay >= NEAR:
        first = -math.expm1(-decay) / decay
        second = (1.0 - first) / decay
        return first, second, (0.5 - second) / decay
    series = 0.0
    for k in range(TERMS, 0, -1):
        series = (series + 1.0) * -decay / (k + 3.0)
    third = (series + 1.0) / 6.0
    second = 0.5 - decay * third
    return 1.0 - decay * second, second, third


@compiled_part
def weigh(rates: Array, length: float, share: float, weights: Array) -> None:
    """Write E, A, B of a fraction of a step of a length (s) into `weights` (3, n)."""
    time = share * length
    for k in range(rates.size):
        if rates[k] == math.inf:
            weights[STAYS, k], weights[STARTS, k], weights[TURNS, k] = 0.0, 1.0, share
            continue
        first, second, _ = phi(rates[k] * time)
        weights[STAYS, k] = 1.0 - rates[k] * time * first
        weights[STARTS, k], weights[TURNS, k] = time * first, time * share * second


@compiled_part
def place_of(modes: Modes, jump: Array, lengths: Lengths, length: float) -> int:
    """Place of a length (s), whose weights are computed if not stored; `jump` is (m, n)."""
    for place in range(lengths.length.size):
        if lengths.length[place] == length:
            return place
    place = lengths.next[0]
    lengths.next[0] = (place + 1) % lengths.length.size
    lengths.length[place] = length
    weights, rates = lengths.weights[place], modes.rates
    for k in range(len(SHARES)):
        weigh(rates, length, SHARES[k], weights[3 * k : 3 * k + 3])
    for k in range(rates.size):
        if rates[k] == math.inf:
            weights[MEAN, k], weights[MEAN + 1, k], weights[MEAN + 2, k] = 0.0, 1.0, 0.5
            weights[BENDS, k] = 0.0
            continue
        first, second, third = phi(rates[k] * length)
        weights[MEAN, k] = first
        weights[MEAN + 1, k], weights[MEAN + 2, k] = length * second, length * third
        weights[BENDS, k] = -(length**3) * (2.0 * third - second)
    for k in range(rates.size):
        for e in range(modes.drawn.shape[1]):
            lengths.storage[k, e] = weights[TURNS, k] * modes.drawn[k, e]
    np.dot(jump, lengths.storage, lengths.influence[place])
    return place
