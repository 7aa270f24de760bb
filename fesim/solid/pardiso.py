"""Factors and solutions by MKL's PARDISO, for symmetric positive definite matrices.

The public calls of pypardiso compare the whole matrix with a copy of it, and store the copy; its
private one copies the pattern and the solution at every call. MKL is therefore called directly.
"""

from __future__ import annotations

import ctypes
import os
import site
import sys
from collections.abc import Callable
from pathlib import Path
from weakref import finalize

import numpy as np
from scipy.sparse import bsr_array, csr_array

from thermojoint.artefacts.arrays import Array

#: From right-hand sides, shape (n,) or (n, k), to solutions of that shape, in the same precision.
Substitution = Callable[[Array], Array]

#: Its phases: fill-in reduction, numerical factorisation, substitution.
ANALYSIS, NUMBERS, SOLUTION = 11, 22, 33

#: Its parameters, numbered from 1: use these instead of the defaults; nested dissection; indices
#: from zero. By default MKL refines every solution twice, which takes four times as long.
PARAMETERS = {1: 1, 2: 2, 35: 1}
#: Parameters for single precision and for the size of blocks, 0 for none.
SINGLE, BLOCK = 28, 37


def pardiso(
    upper: csr_array | bsr_array, single: bool
) -> Callable[[csr_array | bsr_array], Substitution]:
    """Return a function that factorises matrices of one pattern, each until the next one.

    Parameters
    ----------
    upper : scipy.sparse.csr_array or bsr_array, shape (n, n)
        Upper triangle of one of them, without empty rows, which would crash MKL; in blocks, those
        on the diagonal whole. For blocks MKL analyses the pattern of the blocks, not of the
        numbers.
    single : bool
        Whether factors, and so solutions, are in single precision.

    Raises
    ------
    ImportError
        PARDISO is not installed.
    numpy.linalg.LinAlgError
        A matrix is not positive definite.
    """
    _tell_where_mkl_is()
    from pypardiso import PyPardisoSolver

    solver, precision = PyPardisoSolver(mtype=2), np.float32 if single else np.float64
    block = upper.blocksize[0] if isinstance(upper, bsr_array) else 0
    for parameter, value in (PARAMETERS | {SINGLE: int(single), BLOCK: block}).items():
        solver.set_iparm(parameter, value)
    # If a search was necessary, its result is kept.
    os.environ.setdefault("PYPARDISO_MKL_RT", solver.libmkl._name)

    number, to = ctypes.c_int32, ctypes.POINTER(ctypes.c_int32)
    count, one, kind, silent = map(number, (len(upper.indptr) - 1, 1, solver.mtype, 0))
    pattern = [part.astype(np.int32, copy=False) for part in (upper.indptr, upper.indices)]
    store = solver.pt.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))
    starts, columns, order, settings = (
        part.ctypes.data_as(to) for part in (*pattern, solver.perm, solver.iparm)
    )

    def run(phase: int, values: Array, right_side: Array) -> Array:
        """Solution, in column order in memory, of a matrix with these `values`."""
        solution = np.empty_like(right_side)
        many = number(1 if right_side.ndim == 1 else right_side.shape[1])
        error = number(0)
        solver._mkl_pardiso(
            *(store, one, one, kind, number(phase), count),
            *(values.ctypes.data, starts, columns, order, many, settings, silent),
            *(right_side.ctypes.data, solution.ctypes.data, error),
        )
        if error.value:
            raise np.linalg.LinAlgError(f"PARDISO: error {error.value}")
        return solution

    # MKL stores a factorisation until it is released.
    finalize(run, solver.free_memory, everything=True).atexit = False
    nothing = np.zeros(upper.shape[0], precision)
    run(ANALYSIS, upper.data.astype(precision, copy=False), nothing)

    def factorised(matrix: csr_array | bsr_array) -> Substitution:
        values = matrix.data.astype(precision, copy=False)
        run(NUMBERS, values, nothing)

        # Without refinement, MKL does not read the numbers of the matrix again.
        return lambda right_side: run(
            SOLUTION, nothing, np.asfortranarray(right_side, dtype=precision)
        )

    return factorised


def _tell_where_mkl_is() -> None:
    """Set the path of MKL's library, for which pypardiso would search the whole installation.

    The search takes up to a second of every process. MKL's wheels install it in ``lib``.
    """
    if "PYPARDISO_MKL_RT" in os.environ:
        return
    for prefix in (sys.prefix, site.USER_BASE):
        for library in sorted(Path(prefix or "", "lib").glob("libmkl_rt.so*")):
            os.environ.setdefault("PYPARDISO_MKL_RT", str(library))
