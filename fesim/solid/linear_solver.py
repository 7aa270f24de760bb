"""Interface to the direct solvers: factorise once, solve many times.

PARDISO if its wheel is installed, SciPy's SuperLU otherwise; the environment variable `VARIABLE`
sets another default. Both are used for symmetric positive definite matrices; `checked_solve` checks
the residual of a solve.

PARDISO's factors of a large matrix are in single precision: half the memory, half the time. Their
solutions are refined (`fesim.solid.refinement`); if that fails, they are replaced by a factor in
double precision.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array, sparray
from scipy.sparse.linalg import splu

from fesim.solid.pardiso import Substitution, pardiso
from fesim.solid.refinement import refined
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, InputError, UnreadableError

SOLVERS = ("pardiso", "superlu")

#: Environment variable with the default solver.
VARIABLE = "THERMOJOINT_SOLVER"

#: Smallest number of unknowns for factors in single precision: for fewer, refinement takes more
#: time than is saved with two threads.
LARGE = 500_000
#: Smallest number of unknowns for which PARDISO receives the blocks of nodes, if these are known.
BLOCKED = 150_000
#: Largest accepted residual relative to the right-hand side.
RESIDUAL_LIMIT = 1e-6
#: Number of combinations with random signs in which the residuals of many columns are checked: in
#: each the largest one is undiminished with a probability of at least one half.
COMBINED = 16
#: Largest number of numbers in a product: 20 MB.
AT_ONCE = 2_500_000
#: A larger residual is accepted if rounding explains it, up to this fraction of |A| |x| and up to
#: this limit: forces in a body a million times stiffer than its surroundings are large and cancel.
ROUNDING, ROUNDING_LIMIT = 16.0 * float(np.finfo(float).eps), 1e-5


@dataclass(frozen=True)
class Factor:
    """A factorised symmetric positive definite matrix."""

    #: Upper triangle of the factorised matrix.
    matrix: csr_array
    #: From right-hand sides, shape (n,) or (n, k), to solutions of the same shape.
    solve: Callable[[Array], Array]
    #: Name of the solver.
    solver: str


def default_solver() -> str:
    """Return the solver set by `VARIABLE`, else ``"pardiso"`` if installed, else ``"superlu"``.

    Raises
    ------
    UnreadableError
        `VARIABLE` is not a solver.
    """
    named = os.environ.get(VARIABLE)
    if named and named not in SOLVERS:
        raise UnreadableError(f"{VARIABLE}: {named!r} is unknown; use one of {', '.join(SOLVERS)}")
    return named or _installed()


@cache
def _installed() -> str:
    """The best installed solver; cached, as the search goes through all module folders."""
    return "pardiso" if find_spec("pypardiso") else "superlu"


def factorise(matrix: sparray, what: str, solver: str | None = None) -> Factor:
    """Factorise a symmetric positive definite `matrix`.

    Parameters
    ----------
    matrix : scipy.sparse array, shape (n, n)
        Both triangles stored.
    what : str
        Name for the error message, e.g. ``"stiffness"``.
    solver : str, optional
        One of `SOLVERS`; default `default_solver`.

    Raises
    ------
    InputError
        The solver is unknown or not installed, or the matrix is singular.
    """
    return factorise_upper(upper_triangle(csr_array(matrix)), what, solver)


def factorise_upper(
    upper: csr_array,
    what: str,
    solver: str | None = None,
    places: NDArray[np.int64] | None = None,
) -> Factor:
    """Factorise a symmetric positive definite matrix given by its upper triangle.

    Parameters
    ----------
    upper : scipy.sparse.csr_array, shape (n, n)
        As returned by `upper_triangle`.
    what, solver
        As for `factorise`, including the errors raised.
    places : ndarray of int, shape (n,), optional
        Ascending: unknown 3 i + c is direction c at node i. With it, PARDISO's analysis of a large
        matrix takes a quarter of the time and a sixth of the memory.
    """
    large = upper.shape[0] >= LARGE and (solver or default_solver()) == "pardiso"
    if large:
        return _not_singular(_rough_factor(upper, what, places), what)
    return _not_singular(_factoriser(upper, what, solver, places)(upper), what)


def shifted_factors(
    upper: csr_array, least: Array, what: str, solver: str | None = None
) -> Callable[[Array], Factor]:
    """Return a function that factorises A + diag(d) for one diagonal d after the other.

    Their common pattern is analysed once. A factor is valid until the next one is computed.

    Parameters
    ----------
    upper : scipy.sparse.csr_array, shape (n, n)
        Upper triangle of A; every entry of the diagonal is stored.
    least : ndarray, shape (n,)
        The smallest of the diagonals: if A is not singular with it, it is not with the others.
    what, solver
        As for `factorise`, including the errors raised.
    """
    make = _factoriser(upper, what, solver)

    def factor(diagonal: Array) -> Factor:
        data = upper.data.copy()
        # Rows of an upper triangle begin with the diagonal.
        data[upper.indptr[:-1]] += diagonal
        return make(csr_array((data, upper.indices, upper.indptr), shape=upper.shape))

    _not_singular(factor(least), what)
    return factor


def _factoriser(
    upper: csr_array, what: str, solver: str | None, places: NDArray[np.int64] | None = None
) -> Callable[[csr_array], Factor]:
    """Return a function that factorises matrices of one pattern."""
    name = solver or default_solver()
    if name not in SOLVERS:
        raise InputError(f"linear solver: {name!r} is unknown; use one of {', '.join(SOLVERS)}")
    make = _superlu if name == "superlu" else _pardiso(upper, what, False, places)

    def factor(matrix: csr_array) -> Factor:
        try:
            return Factor(matrix, make(matrix), name)
        except np.linalg.LinAlgError as error:
            raise singular(what) from error

    return factor


def _rough_factor(upper: csr_array, what: str, places: NDArray[np.int64] | None) -> Factor:
    """Factorise in single precision, and in double only if that is not sufficient."""
    precise = cache(lambda: _factoriser(upper, what, "pardiso", places)(upper))
    try:
        rough = _pardiso(upper, what, True, places)(upper)
    except np.linalg.LinAlgError:
        return precise()

    def solve(right_side: Array) -> Array:
        solution = refined(partial(_product_in_parts, upper), rough, right_side)
        return precise().solve(right_side) if solution is None else solution

    return Factor(upper, solve, "pardiso")


def _not_singular(factor: Factor, what: str) -> Factor:
    """Return the factor, unless pivots are zero up to rounding, which a solve reveals."""
    probe = np.cos(np.arange(factor.matrix.shape[0]))
    if not _relative_residual(factor, factor.solve(probe), probe) <= RESIDUAL_LIMIT:
        raise singular(what)
    return factor


def upper_triangle(matrix: csr_array) -> csr_array:
    """Return the upper triangle of a matrix, its columns in ascending order."""
    matrix.sort_indices()
    counts = np.diff(matrix.indptr)
    row = np.repeat(np.arange(matrix.shape[0], dtype=matrix.indices.dtype), counts)
    kept = matrix.indices >= row
    indptr = np.concatenate([[0], np.cumsum(kept)])[matrix.indptr].astype(matrix.indptr.dtype)
    return csr_array((matrix.data[kept], matrix.indices[kept], indptr), shape=matrix.shape)


def symmetric_product(upper: csr_array, vectors: Array) -> Array:
    """Multiply a symmetric matrix, given by its upper triangle, by vectors."""
    return np.asarray(upper @ vectors + upper.T @ vectors - (vectors.T * upper.diagonal()).T)


def symmetric(upper: csr_array) -> csr_array:
    """Return a whole symmetric matrix from its upper triangle."""
    return csr_array(upper + upper.T - diags_array(upper.diagonal()))


def checked_solve(factor: Factor, right_side: Array, what: str) -> Array:
    """Solve and raise ConvergenceError if the residual exceeds `RESIDUAL_LIMIT` and rounding."""
    if not right_side.size:
        return np.zeros(right_side.shape)
    solution = factor.solve(right_side)
    residual = _relative_residual(factor, solution, right_side)
    # Written so that NaN fails, too.
    if not (residual <= RESIDUAL_LIMIT or _is_rounding(factor, solution, right_side, residual)):
        raise ConvergenceError(
            f"{what}: the solver left a relative residual of {residual:.1e}; "
            "some body is free to move or a property is out of range: check supports and materials"
        )
    return solution


def _relative_residual(factor: Factor, solution: Array, right_side: Array) -> float:
    left = right_side.reshape(len(right_side), -1)
    found = solution.reshape(left.shape)
    scale = float(max(left.max(), -left.min())) or 1.0
    if left.shape[1] > COMBINED:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (left.shape[1], COMBINED))
        combined = _largest_residual(factor, found @ signs, left @ signs) / scale
        if combined <= RESIDUAL_LIMIT:
            return combined
    return _largest_residual(factor, found, left) / scale


def _largest_residual(factor: Factor, solution: Array, right_side: Array) -> float:
    residual = 0.0
    for part, product in _products(factor.matrix, solution):
        residual = np.maximum(residual, np.abs(product - right_side[part]).max())
    return float(residual)


def _product_in_parts(upper: csr_array, vectors: Array) -> Array:
    """`symmetric_product` of vectors (n, k), in their storage order."""
    found = np.empty_like(vectors)
    for part, product in _products(upper, vectors):
        found[part] = product
    return found


def _products(upper: csr_array, vectors: Array) -> Iterator[tuple[tuple[slice, slice], Array]]:
    """A few columns at a time: all at once would need several times the memory of the vectors."""
    width = max(1, AT_ONCE // len(vectors))
    for first in range(0, vectors.shape[1], width):
        part = np.s_[:, first : first + width]
        yield part, symmetric_product(upper, vectors[part])


def _is_rounding(factor: Factor, solution: Array, right_side: Array, residual: float) -> bool:
    """Whether a relative residual is explained by the rounding of the solution."""
    sizes = symmetric_product(abs(factor.matrix), np.abs(solution))
    least = ROUNDING * float(sizes.max()) / float(np.abs(right_side).max())
    return residual <= min(least, ROUNDING_LIMIT)


def singular(what: str) -> InputError:
    """Return the error for a singular matrix."""
    return InputError(
        f"{what}: the matrix is singular; some body is free to move or has no material: "
        "check supports, joints and materials"
    )


def _superlu(upper: csr_array) -> Substitution:
    try:
        lu = splu(
            csc_array(symmetric(upper)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from error
    return lambda right_side: lu.solve(np.ascontiguousarray(right_side))


def _pardiso(
    upper: csr_array, what: str, single: bool, places: NDArray[np.int64] | None
) -> Callable[[csr_array], Substitution]:
    if not np.diff(upper.indptr).all():
        raise singular(what)
    try:
        if places is None or upper.shape[0] < BLOCKED:
            return pardiso(upper, single)
        return _by_nodes(upper, single, places)
    except ImportError as error:
        raise UnreadableError(
            "linear solver: 'pardiso' is not installed; install the extra "
            "thermojoint[pardiso] or use 'superlu'"
        ) from error


def _by_nodes(
    upper: csr_array, single: bool, places: NDArray[np.int64]
) -> Callable[[csr_array], Substitution]:
    """Factors by PARDISO of matrices in blocks of nodes, for right-hand sides as for `upper`."""
    precision = np.float32 if single else np.float64
    blocks = in_blocks(upper, places, precision)
    make = pardiso(blocks, single)

    def factorised(matrix: csr_array) -> Substitution:
        # Usually it is the matrix whose pattern was analysed, and its blocks are available.
        own = blocks if matrix is upper else in_blocks(matrix, places, precision)
        substitution = make(own)

        def solve(right_side: Array) -> Array:
            shape = (_whole_size(places), *right_side.shape[1:])
            whole = np.zeros(shape, precision, order="F")
            whole.T[..., places] = right_side.T
            return np.asarray(substitution(whole).T[..., places].T)

        return solve

    return factorised


def in_blocks(
    upper: csr_array, places: NDArray[np.int64], precision: type[np.floating]
) -> bsr_array:
    """Return the upper triangle of a symmetric matrix in blocks of three, one per pair of nodes.

    Blocks on the diagonal are whole. The diagonal is one at places without an unknown.

    Parameters
    ----------
    upper : scipy.sparse.csr_array, shape (n, n)
        As returned by `upper_triangle`.
    places : ndarray of int, shape (n,)
        Ascending: unknown 3 i + c is direction c at node i.
    precision : type
        Type of the numbers.
    """
    size = _whole_size(places)
    counts, lacking = np.zeros(size + 1, dtype=np.int32), np.ones(size, dtype=precision)
    counts[places + 1], lacking[places] = np.diff(upper.indptr), 0.0
    columns = places.astype(np.int32)[upper.indices]
    starts = np.cumsum(counts, dtype=np.int32)
    spread = csr_array((upper.data.astype(precision), columns, starts), (size, size))
    blocks = csr_array(spread + diags_array(lacking)).tobsr((3, 3))
    blocks.sort_indices()
    # Rows of an upper triangle begin with the diagonal.
    first = blocks.indptr[:-1]
    blocks.data[first] += np.triu(blocks.data[first], 1).transpose(0, 2, 1)
    return bsr_array(blocks)


def _whole_size(places: NDArray[np.int64]) -> int:
    return 3 * (int(places[-1]) // 3 + 1)
