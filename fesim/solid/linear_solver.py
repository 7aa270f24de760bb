"""The one seam to the direct solvers: factorise once, solve many times.

PARDISO where its wheel is installed, SciPy's SuperLU otherwise; the environment variable
`VARIABLE` names another default. Both take symmetric positive definite matrices here; the residual
of a solve is checked by `checked_solve`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from weakref import finalize

import numpy as np
from scipy.sparse import csc_array, csr_array, csr_matrix, sparray, triu
from scipy.sparse.linalg import splu

from artefacts.arrays import Array
from artefacts.errors import ConvergenceError, InputError

SOLVERS = ("pardiso", "superlu")

#: Names the solver of all cases that name none.
VARIABLE = "THERMOJOINT_SOLVER"

#: A factorisation that leaves more than this, relative to the right-hand side, is no solution.
RESIDUAL_LIMIT = 1e-6
#: A solution of doubles leaves so much of |A| |x|, however good it is: a body that is a million
#: times stiffer than what it moves with has large forces that cancel. But never more than this.
ROUNDING, ROUNDING_LIMIT = 16.0 * float(np.finfo(float).eps), 1e-5


@dataclass(frozen=True)
class Factor:
    """A factorised symmetric positive definite matrix.

    Attributes
    ----------
    matrix : scipy.sparse.csr_array
        What was factorised.
    solve : callable
        Right-hand sides, shape (n,) or (n, k), to solutions of the same shape.
    solver : str
        Which library did it.
    """

    matrix: csr_array
    solve: Callable[[Array], Array]
    solver: str


def default_solver() -> str:
    """Return what `VARIABLE` names; without it ``"pardiso"`` if installed, else ``"superlu"``.

    Raises
    ------
    InputError
        `VARIABLE` names no solver.
    """
    named = os.environ.get(VARIABLE)
    if named and named not in SOLVERS:
        raise InputError(f"{VARIABLE}: {named!r} is unknown; use one of {', '.join(SOLVERS)}")
    return named or ("pardiso" if find_spec("pypardiso") else "superlu")


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
    name = solver or default_solver()
    rows = csr_array(matrix)
    rows.sort_indices()
    if name == "pardiso":
        solve = _pardiso(rows, what)
    elif name == "superlu":
        solve = _superlu(rows, what)
    else:
        raise InputError(f"linear solver: {name!r} is unknown; use one of {', '.join(SOLVERS)}")
    factor = Factor(rows, solve, name)
    # A pivot that is zero but for rounding passes the factorisation; a solve shows it.
    probe = np.cos(np.arange(rows.shape[0]))
    if not _relative_residual(factor, solve(probe), probe) <= RESIDUAL_LIMIT:
        raise _singular(what)
    return factor


def checked_solve(factor: Factor, right_side: Array, what: str) -> Array:
    """Solve and raise ConvergenceError if the residual exceeds `RESIDUAL_LIMIT` and rounding."""
    if not right_side.size:
        return np.zeros(right_side.shape)
    solution = factor.solve(right_side)
    residual = _relative_residual(factor, solution, right_side)
    # Written so that NaN fails too.
    if not (residual <= RESIDUAL_LIMIT or _is_rounding(factor, solution, right_side, residual)):
        raise ConvergenceError(
            f"{what}: the solver left a relative residual of {residual:.1e}; "
            "some body is free to move or a property is out of range: check supports and materials"
        )
    return solution


def _relative_residual(factor: Factor, solution: Array, right_side: Array) -> float:
    residual = float(np.abs(factor.matrix @ solution - right_side).max())
    scale = float(np.abs(right_side).max())
    return residual / scale if scale > 0.0 else residual


def _is_rounding(factor: Factor, solution: Array, right_side: Array, residual: float) -> bool:
    """Whether a relative residual is what the nearest doubles to a solution leave."""
    sizes = abs(factor.matrix) @ np.abs(solution)
    least = ROUNDING * float(sizes.max()) / float(np.abs(right_side).max())
    return residual <= min(least, ROUNDING_LIMIT)


def _singular(what: str) -> InputError:
    return InputError(
        f"{what}: the matrix is singular; some body is free to move or has no material: "
        "check supports, joints and materials"
    )


def _superlu(matrix: csr_array, what: str) -> Callable[[Array], Array]:
    try:
        lu = splu(
            csc_array(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise _singular(what) from error
    return lambda right_side: lu.solve(np.ascontiguousarray(right_side))


def _pardiso(matrix: csr_array, what: str) -> Callable[[Array], Array]:
    try:
        from pypardiso import PyPardisoSolver
        from pypardiso.pardiso_wrapper import PyPardisoError
    except ImportError as error:
        raise InputError(
            "linear solver: 'pardiso' is not installed; install the extra "
            "thermojoint[pardiso] or use 'superlu'"
        ) from error
    upper = csr_matrix(triu(matrix, format="csr"))
    upper.sort_indices()
    solver = PyPardisoSolver(mtype=2)
    # Told where MKL is, the next solver does not search the whole installation for it (0.3 s each).
    os.environ.setdefault("PYPARDISO_MKL_RT", solver.libmkl._name)
    try:
        solver.factorize(upper)
    except (PyPardisoError, ValueError) as error:  # ValueError: a row without entries
        raise _singular(what) from error
    solver.set_phase(33)

    def solve(right_side: Array) -> Array:
        columns = np.asfortranarray(right_side, dtype=np.float64)
        # The public solve() compares the whole matrix with its copy on every call.
        return np.asarray(solver._call_pardiso(upper, columns))

    # MKL keeps a factorisation until it is told to let go of it.
    finalize(solve, solver.free_memory, everything=True).atexit = False
    return solve
