"""Reduced thermal model: Galerkin projection on a rational Krylov basis (docs/reduction.md).

M dT/dt + A T = P u - B^T j is projected on T = V a with V^T M V = I and V^T A V diagonal. The basis
contains the exact responses (A + s M)^-1 [P, B^T] at shifts s spaced evenly in ln s between the
slowest and the fastest time of interest: the solution, for any time step, is a combination of such
responses. Each block adds only directions that exceed the span of the basis by more than a
tolerance (singular value decomposition), which keeps the rank small if neighbouring contact
elements have similar responses. The error is measured: full against reduced transfer function at
shifts between those of the basis, and full against reduced march; if it is too large, more shifts
are used. The basis contains the constant temperature, so that the reduced model keeps the heat
balance to rounding.

The basis also contains the initial field and its free decay, s (A + s M)^-1 M T0, which are checked
in the same way: with the transfer function and with free decay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from fesim.solid.linear_solver import Factor, checked_solve, shifted_factors, upper_triangle
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Directions below this fraction of the responses are rounding errors, and always left out.
ROUNDING = 1e-13
#: Relative accuracy of the full responses: a body without heat loss gets very hot at the slowest
#: shifts, so that no smaller tolerance can be checked.
SOLVED = 1e-9
#: The transfer function is checked at about this many shifts, the march over this many steps of
#: each length, in units of the shortest time: real shifts alone would underestimate the error,
#: which is largest after a few steps or after hundreds of times the shortest time.
CHECKED, STEPS, LENGTHS = 3, 50, (2.0, 6.0)

#: From a diagonal d to the solver of (A + diag(d)) x = right-hand sides.
_Shifted = Callable[[Array], Callable[[Array], Array]]
#: Result of `shifted_factors`.
_Factors = Callable[[Array], Factor]


@dataclass(frozen=True)
class Search:
    """Parameters of the search for a basis."""

    #: Numbers of shifts tried in turn.
    shifts: tuple[int, ...] = (20, 28, 40)
    #: Directions whose size weighted by heat capacity, K (J/K)^0.5, is below this are left out at
    #: first; a tenth of it with every further number of shifts.
    cut: float = 3e-4
    #: Number of random combinations at a time that represent the drives if these are more than
    #: twice as many, until fewer than half of them add a new direction.
    sample: int = 64


USUAL = Search()


@dataclass(frozen=True)
class ReducedHeat:
    """A diagonalised reduced model of r modes."""

    #: Shape (n, r): V, K per unit of each mode.
    basis: Array
    #: Shape (r,): V^T A V, 1/s.
    rates: Array
    #: Largest error of an output between the shifts, relative to its tolerance.
    error: float
    #: Shape (k,): shifts of the basis, 1/s.
    shifts: Array


@dataclass(frozen=True)
class HeatSystem:
    """The heat equation to be reduced, with its inputs and outputs."""

    #: Shape (n,): diagonal of M, J/K.
    capacity: Array
    #: Shape (n, n): a = K + H, W/K, symmetric and positive semidefinite.
    conduction: csr_array
    #: Shape (n, p): right-hand sides, each of typical size, W.
    drives: Array
    #: Shape (q, n): rows of the outputs, each divided by its tolerance.
    outputs: Array
    #: Shape (n, f): initial fields, K.
    start: Array


def reduce_heat(
    system: HeatSystem,
    shortest: float,
    longest: float,
    solver: str | None = None,
    search: Search = USUAL,
) -> ReducedHeat:
    """Reduce the heat equation.

    Parameters
    ----------
    system : HeatSystem
    shortest, longest : float
        Times of interest, s: the shortest step, and the time to a steady state.
    solver : str, optional
        See `fesim.solid.linear_solver.factorise`.
    search : Search, optional

    Raises
    ------
    ConvergenceError
        The error stays above the tolerance with the largest number of shifts.
    """
    capacity, drives, outputs, fields = system.capacity, system.drives, system.outputs, system.start
    stored, what = capacity[:, None] * fields, "reduction of the heat equation"
    upper = upper_triangle(csr_array(system.conduction))
    factors = shifted_factors(upper, capacity / longest, "shifted heat equation", solver)
    exact = _unit_march(lambda added: factors(added).solve, system, shortest)
    cut, error = search.cut, np.inf
    for count in search.shifts:
        shifts = np.geomspace(1.0 / longest, 1.0 / shortest, count)
        vectors = _krylov_basis(system, factors, shifts, cut, search.sample)
        rates, turn = np.linalg.eigh(vectors.T @ (system.conduction @ vectors))
        modes = vectors @ turn
        rates = np.maximum(rates, 0.0)
        reduced = _projected(system, modes, rates)
        between = np.sqrt(shifts[1:] * shifts[:-1])[:: max(1, (count - 1) // CHECKED)]
        error = _largest(exact, _unit_march(_divided(rates), reduced, shortest))
        for shift in between:
            driving = np.hstack([drives, shift * stored])
            answer = checked_solve(factors(shift * capacity), driving, what)
            error = max(error, _transfer_error(outputs @ answer, reduced, shift))
        if error <= 1.0:
            return ReducedHeat(modes, rates, error, shifts)
        cut /= 10.0
    raise ConvergenceError(
        f"{what}: an output is still off by {error:.2g} times its "
        'tolerance; use thermal = "full" in [march]'
    )


def reduce_apart(
    system: HeatSystem, shortest: float, longest: float, solver: str | None = None
) -> ReducedHeat:
    """Reduce the heat equation of bodies that exchange no heat; arguments as for `reduce_heat`.

    Every mode belongs to a single body, so that contact with one body does not involve the modes of
    others. An output of k bodies has the k-th part of its tolerance in each. A body with at least
    half as many inputs as unknowns keeps all its modes: they are exact, and faster to compute.
    """
    count, body = connected_components(system.conduction, directed=False)
    each = [np.flatnonzero(body == k) for k in range(count)]
    shared = sum(system.outputs[:, own].any(axis=1).astype(np.float64) for own in each)
    outputs = system.outputs * np.maximum(shared, 1.0)[:, None]
    parts = []
    for own in each:
        drives, seen = system.drives[own], outputs[:, own]
        alone = HeatSystem(
            system.capacity[own],
            csr_array(system.conduction[own][:, own]),
            drives[:, drives.any(axis=0)],
            seen[seen.any(axis=1)],
            system.start[own],
        )
        if 2 * alone.drives.shape[1] >= own.size:
            parts.append(_all_modes(alone))
        else:
            parts.append(reduce_heat(alone, shortest, longest, solver))
    rates = np.concatenate([part.rates for part in parts])
    basis, first = np.zeros((len(body), rates.size)), 0
    for own, part in zip(each, parts, strict=True):
        basis[own, first : first + part.rates.size] = part.basis
        first += part.rates.size
    finest = max(parts, key=lambda part: part.shifts.size)
    return ReducedHeat(basis, rates, max(part.error for part in parts), finest.shifts)


def _all_modes(system: HeatSystem) -> ReducedHeat:
    root = np.sqrt(system.capacity)
    rates, vectors = np.linalg.eigh(system.conduction.toarray() / root / root[:, None])
    basis = np.ascontiguousarray(vectors / root[:, None])
    return ReducedHeat(basis, np.maximum(rates, 0.0), 0.0, np.empty(0))


def _together(drives: Array) -> Array:
    """Combinations of all inputs in a few columns: with equal and with random signs."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (drives.shape[1], 2))
    return drives @ np.column_stack([np.ones(drives.shape[1]), signs])


def _krylov_basis(
    system: HeatSystem, factors: _Factors, shifts: Array, cut: float, sample: int
) -> Array:
    """Columns (n, r), orthonormal in the capacities, from the responses at all shifts."""
    root, fields = np.sqrt(system.capacity)[:, None], system.start
    basis = _orthonormal(
        root * np.hstack([np.ones(root.shape), fields]), np.empty((len(root), 0)), 0.0
    )
    rank = basis.shape[1]
    for shift in shifts:
        factor = factors(shift * system.capacity)
        driving = np.hstack([system.drives, shift * system.capacity[:, None] * fields])
        for combined in _samples(driving, sample):
            # Unchecked: only the responses that the basis is compared with are checked.
            block = root * factor.solve(combined)
            directions = _orthonormal(block, basis[:, :rank], cut)
            basis = _added(basis, rank, directions)
            rank += directions.shape[1]
            if 2 * directions.shape[1] < combined.shape[1]:
                break
    return np.divide(basis[:, :rank], root, order="C")


def _added(room: Array, rank: int, columns: Array) -> Array:
    """Add columns after the first `rank` of `room`; return a room twice as wide if necessary.

    Columns are contiguous in memory: the first columns of a room are a view.
    """
    width = rank + columns.shape[1]
    if width > room.shape[1]:
        narrow, room = room, np.empty((len(room), 2 * width), order="F")
        room[:, :rank] = narrow[:, :rank]
    room[:, rank:width] = columns
    return room


def _samples(driving: Array, size: int) -> Iterator[Array]:
    """Combinations of right-hand sides (n, k): single ones if there are few, else random ones.

    A combination is scaled so that inputs of unit size give a response of unit size.
    """
    count = driving.shape[1]
    if count <= 2 * size:
        yield driving
        return
    rng = np.random.default_rng(0)
    for _ in range(-(-count // size)):
        yield driving @ (rng.standard_normal((count, size)) / np.sqrt(size))


def _unit_march(solver: _Shifted, system: HeatSystem, shortest: float) -> Array:
    """Outputs (q, steps (p + f)) of `STEPS` of each of `LENGTHS`: driven steps, and free decay."""
    drives = _together(system.drives)
    right_side = np.asfortranarray(np.hstack([drives, np.zeros(system.start.shape)]))
    state, responses = np.hstack([np.zeros(drives.shape), system.start]), []
    for length in LENGTHS:
        rate = system.capacity / (length * shortest)
        solve, states = solver(rate), []
        for _ in range(STEPS):
            state = solve(right_side + rate[:, None] * state)
            states.append(state)
        responses.append(system.outputs @ np.hstack(states))
    return np.hstack(responses)


def _projected(system: HeatSystem, modes: Array, rates: Array) -> HeatSystem:
    """The reduced model, with unit capacities and diagonal conduction."""
    return HeatSystem(
        np.ones(rates.size),
        csr_array(diags_array(rates)),
        modes.T @ system.drives,
        system.outputs @ modes,
        modes.T @ (system.capacity[:, None] * system.start),
    )


def _divided(rates: Array) -> _Shifted:
    """Solver of a reduced model."""
    return lambda added: lambda right_side: right_side / (rates + added)[:, None]


def _transfer_error(exact: Array, reduced: HeatSystem, shift: float) -> float:
    driving = np.hstack([reduced.drives, shift * reduced.start])
    return _largest(exact, (reduced.outputs / (reduced.conduction.diagonal() + shift)) @ driving)


def _largest(exact: Array, reduced: Array) -> float:
    """Largest error in units of its tolerance, or of `SOLVED` for huge outputs."""
    return float(np.abs(exact - reduced).max() / (1.0 + SOLVED * np.abs(exact).max()))


def _orthonormal(block: Array, basis: Array, cut: float) -> Array:
    """Orthonormal directions of `block` outside `basis` by more than `cut` and rounding."""
    least = max(cut, ROUNDING * float(np.linalg.norm(block)))
    rest, sizes = _principal(_without(block, basis))
    # With a large block, rounding leaves components of the basis in a small direction: project
    # again, each direction by itself, and only then decide.
    rest, sizes = _principal(_without(rest[:, sizes > least / 2.0], basis))
    directions = rest[:, sizes > least] / sizes[sizes > least]
    # Orthogonal up to the rounding of the larger ones, which is small enough for their squares.
    lower = np.linalg.cholesky(directions.T @ directions)
    return np.asarray(directions @ np.linalg.inv(lower).T)


def _without(block: Array, basis: Array) -> Array:
    return np.asarray(block - basis @ (basis.T @ block))


def _principal(block: Array) -> tuple[Array, Array]:
    """Left singular vectors times their singular values, and these.

    Without orthogonalising the vectors themselves, which takes most of the time for a tall matrix.
    """
    _, sizes, turn = np.linalg.svd(np.linalg.qr(block, mode="r"), full_matrices=False)
    return block @ turn.T, sizes
