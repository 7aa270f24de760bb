"""JIT-compiled solution of the gap equations for built-in laws (`fesim.joint.gap`).

Same residual, tangent, line search and tolerance. The difference is the linear algebra of a Newton
step. The tangent of the residual is J = I - F dT with dT = T + k0: since the springs k0 are as
stiff as the joint at its preload while it sticks, dT is nonzero only in the pressure of a contact
element and in the shear of a sliding one. So the linear system has as many unknowns as there are
such tractions, not three for each contact element.

Start at `solve_in_place` next to `fesim.joint.gap.solve_gap`: the same method, line by line.
`tests/fesim/joint/test_compiled_gap.py` compares law, equilibria and march with the plain ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.gap import (
    MAX_FULL_STEPS,
    MAX_ITERATIONS,
    SHORTEST_STEP,
    TOLERANCE,
    Equilibrium,
    GapProblem,
    singular,
    stalled,
    unconverged,
)
from fesim.joint.in_place import add, put
from fesim.joint.law import (
    ACROSS,
    ALONG,
    CROSS,
    FIRST,
    NORMAL,
    SECOND,
    BackBurdekinLaw,
    JointLaw,
    SurfaceNormalLaw,
    Traction,
)
from fesim.joint.linear_system import factorise_columns, solve_again
from fesim.joint.opening import OpenLaw
from thermojoint.artefacts.arrays import Array

#: Columns of the table of laws, one row for each contact element.
_KIND, _SCALE, _SHAPE, _START, _PRELOAD, _FRICTION, _STIFFNESS = range(7)
_SURFACE, _BACK_BURDEKIN = 0.0, 1.0
_SOLVED, _STALLED, _UNCONVERGED = range(3)
#: Fraction of the tolerance that stored factors may leave, as they converge linearly: friction
#: remembers the residual, and errors are estimated from differences of equilibria.
CLOSER = 0.1


class GapKernel(NamedTuple):
    """The gap equations of one machine in compiled form."""

    #: Shape (3 m,): k0, Pa/m.
    springs: Array
    #: Shape (3 m, 3 m): F and its transpose, m/Pa; the latter for `solve_in_place` alone.
    compliance: Array
    columns: Array
    #: Shape (m, 7): parameters of the law of each contact element.
    laws: Array
    #: Largest residual accepted, m.
    tolerance: float
    #: Fraction of the residual that an iteration with stored factors may leave; zero: no reuse.
    left: float = 0.0


class Trial(NamedTuple):
    """Trial gaps and the law evaluated there, written in place."""

    #: Shape (3, m): gaps, m, and tractions over the preload, Pa.
    gap: Array
    value: Array
    #: Shape (2, m): slip, m.
    moved: Array
    #: Shape (6, m): as in `fesim.joint.law.Traction`, Pa/m.
    tangent: Array


@dataclass(frozen=True)
class CompiledGap:
    """The gap equations of one machine."""

    #: Linear part.
    problem: GapProblem
    #: Shape (m, 7): parameters of the law of each contact element.
    laws: Array

    def kernel(self, columns: Array, tolerance: float) -> GapKernel:
        """Return its data for compiled code, for residuals up to a tolerance, m.

        `columns`: F transposed, (3 m, 3 m), m/Pa, or an empty matrix if it is not used.
        """
        springs, compliance = self.problem.springs, self.problem.compliance
        return GapKernel(springs, compliance, columns, self.laws, tolerance)

    def solve(
        self, thermal_gap: Array, slip: Array, guess: Array, tolerance: float = TOLERANCE
    ) -> Equilibrium:
        """Find the gaps in equilibrium with a thermal gap; see `fesim.joint.gap.solve_gap`."""
        trial, kernel = trial_at(guess), self.kernel(self.problem.columns, tolerance)
        try:
            outcome, size, iterations = solve_in_place(
                kernel, self.problem.at_rest(thermal_gap), slip, trial, newton_work(slip.shape[1])
            )
        except np.linalg.LinAlgError as error:
            raise singular() from error
        if outcome == _STALLED:
            raise stalled(size)
        if outcome == _UNCONVERGED:
            raise unconverged(size, tolerance)
        traction = Traction(trial.value, trial.tangent, trial.moved)
        return Equilibrium(trial.gap, traction, size, iterations)


def compile_gap(problem: GapProblem, laws: Sequence[tuple[JointLaw, int]]) -> CompiledGap | None:
    """Prepare the gap equations, or return None if a law is not a built-in one.

    Parameters
    ----------
    problem : GapProblem
        Gap equations with the springs of these laws.
    laws : sequence of (JointLaw, int)
        The law of each joint and its number of contact elements.
    """
    rows = []
    for law, count in laws:
        row = _row(law)
        if row is None:
            return None
        table = np.tile(row, (count, 1))
        if isinstance(law.normal, OpenLaw):
            # Both laws count the opening from the state at their reference pressure.
            sign = 1.0 if row[_KIND] == _SURFACE else -1.0
            table[:, _START] += sign * law.normal.shift
        rows.append(table)
    return CompiledGap(problem, np.concatenate([np.empty((0, 7)), *rows]))


def _row(law: JointLaw) -> list[float] | None:
    friction = [law.friction.coefficient, law.friction.stiffness]
    # Not isinstance: a derived law may differ.
    match law.normal.law if isinstance(law.normal, OpenLaw) else law.normal:
        case SurfaceNormalLaw() as surface if type(surface) is SurfaceNormalLaw:
            scale, shape, start = surface.hardness, surface.roughness, surface.separation
            return [_SURFACE, scale, shape, start, law.preload, *friction]
        case BackBurdekinLaw() as power if type(power) is BackBurdekinLaw:
            scale, shape = power.coefficient, power.exponent
            start = scale * power.preload**shape
            return [_BACK_BURDEKIN, scale, shape, start, law.preload, *friction]
    return None


def trial_at(gap: Array) -> Trial:
    """Return storage for a trial that starts at gaps (3, m)."""
    count = gap.shape[1]
    return Trial(np.array(gap), np.empty((3, count)), np.empty((2, count)), np.empty((6, count)))


@compiled_part
def _pressure(law: Array, opening: float) -> tuple[float, float]:
    """Pressure (Pa) and its slope (Pa/m), as in `SurfaceNormalLaw` and `BackBurdekinLaw`."""
    if law[_KIND] == _SURFACE:
        scaled = (law[_START] + opening) / (math.sqrt(2.0) * law[_SHAPE])
        bell = math.exp(-min(scaled * scaled, 700.0))
        slope = -law[_SCALE] * bell / (math.sqrt(2.0 * math.pi) * law[_SHAPE])
        return 0.5 * law[_SCALE] * math.erfc(scaled), slope
    approach = (law[_START] - opening) / law[_SCALE]
    if approach <= 0.0:
        return 0.0, 0.0
    power = 1.0 / law[_SHAPE]
    return approach**power, -power / law[_SCALE] * approach ** (power - 1.0)


@compiled
def evaluate_in_place(laws: Array, slip: Array, trial: Trial) -> None:
    """Evaluate the law at the gaps of a trial, in place, as `fesim.joint.law.evaluate`."""
    gap, value, moved, tangent = trial.gap, trial.value, trial.moved, trial.tangent
    for e in range(laws.shape[0]):
        law = laws[e]
        pressure, slope = _pressure(law, gap[0, e])
        stiffness = law[_STIFFNESS]
        first = -stiffness * (gap[1, e] - slip[0, e])
        second = -stiffness * (gap[2, e] - slip[1, e])
        size, bound = math.sqrt(first * first + second * second), law[_FRICTION] * pressure
        value[0, e] = pressure - law[_PRELOAD]
        tangent[NORMAL, e] = slope
        if size <= bound and bound > 0.0:
            value[1, e], value[2, e] = first, second
            moved[0, e], moved[1, e] = slip[0, e], slip[1, e]
            tangent[FIRST, e] = tangent[SECOND, e] = tangent[CROSS, e] = 0.0
            tangent[ALONG, e] = tangent[ACROSS, e] = -stiffness
            continue
        along = across = ratio = 0.0
        if size > 0.0:
            along, across, ratio = first / size, second / size, bound / size
        value[1, e], value[2, e] = bound * along, bound * across
        moved[0, e] = gap[1, e] + value[1, e] / stiffness
        moved[1, e] = gap[2, e] + value[2, e] / stiffness
        tangent[FIRST, e] = law[_FRICTION] * slope * along
        tangent[SECOND, e] = law[_FRICTION] * slope * across
        tangent[ALONG, e] = -stiffness * ratio * (1.0 - along * along)
        tangent[CROSS, e] = stiffness * ratio * along * across
        tangent[ACROSS, e] = -stiffness * ratio * (1.0 - across * across)


@compiled_part
def _residual(
    kernel: GapKernel, free_gap: Array, trial: Trial, remainder: Array, residual: Array
) -> None:
    """Write r(g) into `residual`; `remainder` is a work array."""
    gap, value, springs = trial.gap, trial.value, kernel.springs
    count = gap.shape[1]
    for i in range(3):
        for e in range(count):
            remainder[i * count + e] = value[i, e] + springs[i * count + e] * gap[i, e]
    np.dot(kernel.compliance, remainder, residual)
    for i in range(3):
        for e in range(count):
            at = i * count + e
            residual[at] = gap[i, e] - free_gap[at] - residual[at]


@compiled_part
def lacking_rows(springs: Array, tangent: Array, rows: NDArray[np.int64]) -> int:
    """Write the indices of the nonzero rows of dT into `rows` (3 m,); return their number.

    They are the pressures, and both shears of each sliding contact element.
    """
    count = tangent.shape[1]
    size = count
    for e in range(count):
        rows[e] = e
    for e in range(count):
        if (
            tangent[ALONG, e] != -springs[count + e]
            or tangent[FIRST, e] != 0.0
            or tangent[SECOND, e] != 0.0
        ):
            rows[size], rows[size + 1] = count + e, 2 * count + e
            size += 2
    return size


@compiled_part
def lacking(springs: Array, tangent: Array, row: int) -> tuple[float, float, float]:
    """Entries of a row of dT: for the opening and both tangents of its contact element."""
    count = tangent.shape[1]
    part, e = divmod(row, count)
    if part == 0:
        return tangent[NORMAL, e] + springs[e], 0.0, 0.0
    if part == 1:
        return tangent[FIRST, e], tangent[ALONG, e] + springs[count + e], tangent[CROSS, e]
    return tangent[SECOND, e], tangent[CROSS, e], tangent[ACROSS, e] + springs[2 * count + e]


@compiled_part
def lacking_entries(
    springs: Array, tangent: Array, rows: NDArray[np.int64], entries: Array
) -> None:
    """Write `lacking` of as many rows of `rows` as `entries` (3, n) has columns."""
    for k in range(entries.shape[1]):
        entries[0, k], entries[1, k], entries[2, k] = lacking(springs, tangent, rows[k])


@compiled_part
def lacking_system(
    columns: Array, entries: Array, rows: NDArray[np.int64], system: NDArray[np.floating]
) -> None:
    """Write I - dT F of `lacking_entries` (3, n), in column order, into `system` (n, n).

    `columns` (3 m, 3 m) is F transposed. The pressures are the first rows, which are read and
    written in storage order.
    """
    count = columns.shape[0] // 3
    for j in range(system.shape[0]):
        column, into = columns[rows[j]], system[j]
        for k in range(count):
            into[k] = -entries[0, k] * column[k]
        # Then both shears of one contact element after another, as in `lacking_rows`.
        for pair in range(count, into.size, 2):
            e = rows[pair] - count
            opening, first, second = column[e], column[count + e], column[2 * count + e]
            for k in range(pair, pair + 2):
                into[k] = -entries[0, k] * opening
                into[k] -= entries[1, k] * first + entries[2, k] * second
        into[j] += 1.0


class NewtonWork(NamedTuple):
    """Work arrays of Newton's method for m contact elements, kept from solve to solve."""

    #: Shape (3 m,): tractions, Pa, and gaps, m.
    remainder: Array
    residual: Array
    step: Array
    before: Array
    forces: Array
    moved: Array
    #: Shape (3 m,): nonzero rows of dT.
    rows: NDArray[np.int64]
    #: Shapes (9 m,) and (9 m^2,): entries of these rows, and the system and then its factors.
    entries: Array
    system: Array
    #: Shape (3 m,): pivots of the factors; shape (1,): their size, zero if there are none.
    pivots: NDArray[np.int32]
    kept: NDArray[np.int64]


@compiled
def newton_work(count: int) -> NewtonWork:
    """Work arrays for `count` contact elements."""
    size = 3 * count
    return NewtonWork(
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size, dtype=np.int64),
        np.empty(3 * size),
        np.empty(size * size),
        np.empty(size, dtype=np.int32),
        np.zeros(1, dtype=np.int64),
    )


@compiled_part
def _newton_step(kernel: GapKernel, tangent: Array, work: NewtonWork, anew: bool) -> None:
    """Compute -J^-1 r with the present tangent, or with the last one that was factorised.

    With y = dT step, the tractions missing in the springs: (I - dT F) y = -dT r on the nonzero rows
    of dT, and step = F y - r.
    """
    columns, rows, step = kernel.columns, work.rows, work.step
    lacks, moved = work.remainder, work.moved
    count = tangent.shape[1]
    for i in range(3 * count):
        step[i], lacks[i] = -work.residual[i], 0.0
    size = lacking_rows(kernel.springs, tangent, rows) if anew else work.kept[0]
    entries, forces = work.entries[: 3 * size].reshape(3, size), work.forces[:size]
    system, pivots = work.system[: size * size].reshape(size, size), work.pivots[:size]
    if anew:
        lacking_entries(kernel.springs, tangent, rows, entries)
    for k in range(size):
        # The pressures, then both shears of one contact element after another.
        e = k if k < count else rows[k - (k - count) % 2] - count
        forces[k] = entries[0, k] * step[e] + entries[1, k] * step[count + e]
        forces[k] += entries[2, k] * step[2 * count + e]
    if anew:
        lacking_system(columns, entries, rows, system)
        work.kept[0] = 0
        factorise_columns(system, pivots, forces)
        work.kept[0] = size
    else:
        solve_again(system, pivots, forces)
    for k in range(size):
        lacks[rows[k]] = forces[k]
    np.dot(kernel.compliance, lacks, moved)
    add(moved, step)


@compiled_part
def largest(values: Array) -> float:
    """The largest magnitude; NaN if any value is NaN, so that it does not look like convergence."""
    maximum = 0.0
    for value in values.flat:
        if math.isnan(value):
            return math.nan
        maximum = max(maximum, abs(value))
    return maximum


@compiled
def solve_in_place(
    kernel: GapKernel, free_gap: Array, slip: Array, trial: Trial, work: NewtonWork
) -> tuple[int, float, int]:
    """Newton's method from the gaps of a trial: outcome (0: solved), residual, iterations."""
    gap = trial.gap
    count = gap.shape[1]
    remainder, residual, step = work.remainder, work.residual, work.step
    before = work.before.reshape(3, count)
    evaluate_in_place(kernel.laws, slip, trial)
    _residual(kernel, free_gap, trial, remainder, residual)
    full_steps, size = MAX_FULL_STEPS, largest(residual)
    settled = kernel.left == 0.0
    anew = settled or work.kept[0] == 0
    for iteration in range(MAX_ITERATIONS):
        wanted = kernel.tolerance * (1.0 if settled else CLOSER)
        if size <= wanted and np.spacing(largest(gap)) <= kernel.tolerance:
            return _SOLVED, size, iteration
        _newton_step(kernel, trial.tangent, work, anew)
        put(gap, before)
        norm, length = math.sqrt(residual @ residual), 1.0
        while True:
            for i in range(3):
                for e in range(count):
                    gap[i, e] = before[i, e] + length * step[i * count + e]
            evaluate_in_place(kernel.laws, slip, trial)
            _residual(kernel, free_gap, trial, remainder, residual)
            rest = math.sqrt(residual @ residual)
            if rest <= (1.0 - 1e-4 * length) * norm:
                slow = rest > kernel.left * norm
                settled, anew = anew or slow, slow
                break
            if not anew:
                # Back to the gaps before the step, for a new factorisation.
                settled = anew = True
                put(before, gap)
                evaluate_in_place(kernel.laws, slip, trial)
                _residual(kernel, free_gap, trial, remainder, residual)
                break
            length /= 2.0
            if length < SHORTEST_STEP:
                # A full step leaves a kink of the law (`fesim.joint.gap.solve_gap`).
                if full_steps == 0:
                    return _STALLED, size, iteration
                full_steps -= 1
                for i in range(3):
                    for e in range(count):
                        gap[i, e] = before[i, e] + step[i * count + e]
                evaluate_in_place(kernel.laws, slip, trial)
                _residual(kernel, free_gap, trial, remainder, residual)
                break
        size = largest(residual)
    return _UNCONVERGED, size, MAX_ITERATIONS
