"""Contact problem of a condensed structure: the data of a step's gap equations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from fesim.joint.gap import Equilibrium, GapProblem, gap_problem, solve_gap
from fesim.joint.law import JointLaw, Traction, evaluate, stiffness_at_rest
from fesim.solid.condensation import ElasticCondensation, LoadInfluence
from fesim.solid.rigid_motions import Constraints
from thermojoint.artefacts.arrays import Array

if TYPE_CHECKING:
    from fesim.joint.blocks import Blocks
    from fesim.joint.loosening import Watch

#: Thermal gap (3 m,), slip (2, m) at the start of the step and a first guess of the gaps (3, m).
Settle = Callable[[Array, Array, Array], Equilibrium]
#: Largest residual of the gap equations, relative to the gap that closes a joint with its stiffness
#: at preload: this bounds the error of the pressure for any stiffness. It is 1e-13 m in the
#: reference machine, whose published figures were computed with that value.
SHARE = 2.508557e-7
#: The law of each joint and its number of contact elements.
Laws = Sequence[tuple[JointLaw, int]]


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """The joints of a condensed structure: their laws, and the gaps due to heat and loads."""

    #: Elasticity of gaps and displacement probes.
    elastic: ElasticCondensation
    #: The law of each joint and its number of contact elements, in their order.
    laws: Laws
    #: Largest residual of the gap equations, m; default `SHARE` of the closing of the stiffest
    #: joint.
    gap_tolerance: float | None = None
    #: Constraints of the bodies; with them, a step in which a body comes loose is an error.
    constraints: Constraints | None = None
    #: Mechanical loads; their factors follow the other inputs of a step.
    loads: LoadInfluence | None = None

    @property
    def count(self) -> int:
        """Number of contact elements."""
        return sum(count for _, count in self.laws)

    @cached_property
    def gap_problem(self) -> GapProblem:
        """The gap equations."""
        elastic = self.elastic
        return gap_problem(
            elastic.compliance,
            elastic.area,
            elastic.reference,
            stiffness_at_rest(self.laws),
            self.traction,
        )

    @cached_property
    def tolerance(self) -> float:
        """Largest residual of the gap equations, m."""
        if self.gap_tolerance is not None:
            return self.gap_tolerance
        springs = self.gap_problem.springs[: self.count]
        return SHARE * float((self.reference_pressure / springs).min(initial=np.inf))

    @cached_property
    def settle(self) -> Settle:
        """Compiled solver of the gap equations."""
        return gap_solver(self)

    @cached_property
    def blocks(self) -> Blocks:
        """Weakly coupled blocks of contact elements; a single one if no constraints are known."""
        # Imported here, as in `gap_solver`.
        from fesim.joint.blocks import blocks_of, whole

        problem, constraints = self.gap_problem, self.constraints
        if constraints is None:
            return whole(problem)
        counts = [count for _, count in self.laws]
        return blocks_of(problem, counts, constraints.share, constraints.supports)

    @cached_property
    def watch(self) -> Watch | None:
        """Detection of loose bodies."""
        # Imported here, as in `gap_solver`.
        from fesim.joint.loosening import watch_of

        return None if self.constraints is None else watch_of(self.constraints, self.laws)

    def slices(self) -> Iterator[tuple[JointLaw, slice]]:
        """Yield the law of each joint and the slice of its contact elements."""
        start = 0
        for law, count in self.laws:
            yield law, slice(start, start + count)
            start += count

    def traction(self, gap: Array, slip: Array) -> Traction:
        """Evaluate every joint's law; shapes as in `fesim.joint.law.evaluate`."""
        parts = [evaluate(law, gap[:, at], slip[:, at]) for law, at in self.slices()]
        if len(parts) == 1:
            return parts[0]
        return Traction(
            np.concatenate([part.value for part in parts], axis=-1),
            np.concatenate([part.tangent for part in parts], axis=-1),
            np.concatenate([part.slip for part in parts], axis=-1),
        )

    def conductance(self, pressure: Array) -> Array:
        """Eq. 11 at every contact element, W/(m2 K)."""
        parts = [law.conductance(pressure[at]) for law, at in self.slices()]
        return np.concatenate([np.empty(0), *parts])

    def conducts(self, pressure: Array, opening: Array, rise: Array, jump: Array) -> Array:
        """Contact and gap together at every contact element, W/(m2 K), as `JointLaw.conducts`."""
        parts = [
            law.conducts(pressure[at], opening[at], rise[at], jump[at]) for law, at in self.slices()
        ]
        return np.concatenate([np.empty(0), *parts])

    @cached_property
    def conducts_by_pressure(self) -> bool:
        """Whether the conductance depends on the pressures alone."""
        return all(law.conducts_by_pressure for law, _ in self.laws)

    @cached_property
    def reference_pressure(self) -> Array:
        """Preload of every contact element, or its reference pressure if it has none, Pa."""
        parts = [np.full(count, law.reference_pressure) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts])

    @cached_property
    def pressure_limit(self) -> Array:
        """Pressure of every contact element beyond which its law is invalid, Pa."""
        parts = [np.full(count, law.pressure_limit) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts])

    @cached_property
    def preload(self) -> Array:
        """Preload of every contact element, Pa."""
        parts = [np.full(count, law.preload) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts])


def gap_solver(contact: ContactProblem) -> Settle:
    """Return the solver of a gap problem: compiled, or `solve_gap` if a law is not built in."""
    # Imported here because it loads a compiler, which structures without joints do not need.
    from fesim.joint.compiled_gap import compile_gap

    problem, tolerance = contact.gap_problem, contact.tolerance
    compiled = compile_gap(problem, contact.laws)
    if compiled is None:
        return partial(solve_gap, problem, tolerance=tolerance)
    if contact.blocks.starts.size > 2:
        from fesim.joint.modified_newton import solve_in_blocks

        return partial(solve_in_blocks, compiled, contact.blocks, tolerance=tolerance)
    return partial(compiled.solve, tolerance=tolerance)
