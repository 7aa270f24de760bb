"""The reduced heat equation by itself: its modes, what it keeps, how honest its error is."""

from dataclasses import dataclass

import numpy as np
import pytest
from bars import assemble, conduct, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from fesim.march.reduced import TEMPERATURE_ERROR, outputs_of, thermal_modes
from fesim.solid.reduction import (
    HeatSystem,
    ReducedHeat,
    Search,
    reduce_apart,
    reduce_heat,
)
from fesim.solid.spaces import probe_rows
from thermojoint.artefacts.errors import ConvergenceError

SHORTEST, LONGEST = 1.0, 1e6


@dataclass(frozen=True)
class Problem:
    """What `reduce_heat` takes: capacities, A, right-hand sides, rows of the outputs."""

    capacity: np.ndarray
    conduction: csr_array
    drives: np.ndarray
    outputs: np.ndarray

    def system(self, looser: float = 1.0) -> HeatSystem:
        at_rest = np.empty((len(self.capacity), 0))
        outputs = self.outputs / looser
        return HeatSystem(self.capacity, self.conduction, self.drives, outputs, at_rest)

    def reduce(self, looser: float = 1.0, **search) -> ReducedHeat:
        return reduce_heat(self.system(looser), SHORTEST, LONGEST, search=Search(**search))

    def march(self, step, levels):
        """Outputs (steps, q) of the full model; levels (steps, p) of the drives."""
        factor = splu((self.conduction + diags_array(self.capacity / step)).tocsc())
        state, found = np.zeros_like(self.capacity), []
        for level in levels:
            state = factor.solve(self.capacity / step * state + self.drives @ level)
            found.append(self.outputs @ state)
        return np.array(found)

    def reduced_march(self, found, step, levels):
        """The same of a reduced model, and its states (steps, r)."""
        drives, state, states = found.basis.T @ self.drives, np.zeros(found.rates.size), []
        for level in levels:
            state = (state / step + drives @ level) / (1.0 / step + found.rates)
            states.append(state)
        return np.array(states) @ (self.outputs @ found.basis).T, np.array(states)


def bars_problem(convection=None):
    """Two bars, 1 kW on top of one of them and 1 kW shared by the joint's contact elements."""
    parts = conduct(
        two_bars(left=(6, 5, 3), right=(6, 5, 3)),
        convection={"bottom": 50.0} if convection is None else convection,
        sources={"left_top": 1.0},
    )
    structure, jump = parts.structure, parts.operators.jump.toarray()
    rows = probe_rows(parts.spaces.heat, structure, structure.probes).toarray()
    return Problem(
        parts.heat.capacity.diagonal(),
        csr_array(parts.heat.conduction + parts.heat.convection),
        np.hstack([1e3 * parts.heat.inputs[:, :1], 1e3 / len(jump) * jump.T]),
        np.vstack([jump, rows]) / TEMPERATURE_ERROR,
    )


@pytest.fixture(scope="module")
def problem():
    return bars_problem()


@pytest.fixture(scope="module")
def reduced(problem):
    return problem.reduce()


def test_the_modes_store_heat_each_for_itself(problem, reduced):
    basis = reduced.basis
    stored = basis.T @ (problem.capacity[:, None] * basis)
    np.testing.assert_allclose(stored, np.eye(reduced.rates.size), atol=1e-12)


def test_the_modes_decay_each_for_itself(problem, reduced):
    decay = reduced.basis.T @ (problem.conduction @ reduced.basis)
    largest = reduced.rates.max()
    np.testing.assert_allclose(decay, np.diag(reduced.rates), atol=1e-11 * largest)
    assert (np.diff(reduced.rates) >= 0.0).all()


def test_there_are_far_fewer_modes_than_nodes(problem, reduced):
    assert reduced.rates.size < 0.4 * problem.capacity.size
    assert reduced.error <= 1.0


def test_one_temperature_everywhere_is_a_state_of_the_reduced_model(problem, reduced):
    level = reduced.basis @ (reduced.basis.T @ problem.capacity)
    np.testing.assert_allclose(level, 1.0, rtol=1e-11)


@pytest.mark.parametrize("step", [1.0, 2.0, 7.3, 600.0])
def test_any_step_gives_the_full_march(problem, reduced, step):
    """One basis serves every step, within the recorded error times the size of the drives."""
    rng = np.random.default_rng(3)
    levels = np.cumsum(rng.uniform(-0.3, 0.3, (100, problem.drives.shape[1])), axis=0)
    size = np.abs(levels).sum(axis=1).max()
    full = problem.march(step, levels)
    off = full - problem.reduced_march(reduced, step, levels)[0]
    assert np.abs(off).max() <= reduced.error * size
    assert np.abs(full).max() > 1e4


def test_bodies_reduced_apart_have_modes_of_their_own_and_give_the_full_march(problem):
    found = reduce_apart(problem.system(), SHORTEST, LONGEST)
    _, body = connected_components(problem.conduction, directed=False)
    held = np.array([found.basis[body == k].any(axis=0) for k in range(2)])
    assert (held.sum(axis=0) == 1).all()
    assert held.any(axis=1).all()
    assert found.error <= 1.0
    rng = np.random.default_rng(3)
    levels = np.cumsum(rng.uniform(-0.3, 0.3, (100, problem.drives.shape[1])), axis=0)
    off = problem.march(2.0, levels) - problem.reduced_march(found, 2.0, levels)[0]
    # Jumps are outputs of both bodies, and the two errors add up to the tolerance at most.
    assert np.abs(off).max() <= np.abs(levels).sum(axis=1).max()


def test_bodies_with_inputs_at_every_node_keep_all_their_modes_and_march_exactly(problem):
    count = problem.capacity.size
    everywhere = Problem(problem.capacity, problem.conduction, np.eye(count), problem.outputs)
    found = reduce_apart(everywhere.system(), SHORTEST, LONGEST)
    assert found.rates.size == count
    levels = np.cumsum(np.random.default_rng(3).uniform(-1.0, 1.0, (50, count)), axis=0)
    full = everywhere.march(2.0, levels)
    reduced = everywhere.reduced_march(found, 2.0, levels)[0]
    assert np.allclose(reduced, full, rtol=0.0, atol=1e-12 * np.abs(full).max())


@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_the_recorded_error_is_of_the_size_that_a_march_finds(problem, count):
    """Bases from too few shifts; a march of another step, that heats and cools."""
    looser = 1e6
    found = problem.reduce(looser, shifts=(count,))
    levels = np.ones((300, problem.drives.shape[1]))
    levels[150:] = 0.0
    off = problem.march(3.0, levels) - problem.reduced_march(found, 3.0, levels)[0]
    measured = np.abs(off).max()
    recorded = looser * found.error
    # Of the same size: neither a bound that is always kept nor a figure that flatters.
    assert 0.5 * recorded <= measured <= 1.5 * recorded


def test_fewer_shifts_are_worse(problem):
    errors = [problem.reduce(1e6, shifts=(count,)).error for count in (2, 4, 8, 16)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-2 * errors[0]


def test_a_basis_too_crude_is_refused(problem):
    with pytest.raises(ConvergenceError, match="times its tolerance") as caught:
        problem.reduce(shifts=(2, 3))
    assert "\n" not in str(caught.value)
    assert 'thermal = "full"' in str(caught.value)
    assert float(str(caught.value).split("off by ")[1].split()[0]) > 1.0


def test_a_first_cut_too_coarse_is_refined(problem):
    """A tenth of the cut with every round of more shifts, until the error is allowed."""
    found = problem.reduce(cut=1e-1)
    assert found.error <= 1.0
    assert found.shifts.size > Search().shifts[0]


def test_what_gives_off_no_heat_is_reduced_too():
    """It gets hotter and hotter: as many rates are zero as there are bodies."""
    problem = bars_problem(convection={})
    found = problem.reduce()
    assert found.error <= 1.0
    np.testing.assert_allclose(found.rates[:2], 0.0, atol=1e-14)
    assert found.rates[2] > 1e-4


def test_heat_a_thousand_times_too_large_does_not_spoil_the_modes():
    """Rounding of huge responses is not taken for directions."""
    problem = bars_problem(convection={})
    drives = problem.drives * np.concatenate([[1e3], np.ones(problem.drives.shape[1] - 1)])
    found = Problem(problem.capacity, problem.conduction, drives, problem.outputs).reduce()
    stored = found.basis.T @ (problem.capacity[:, None] * found.basis)
    np.testing.assert_allclose(stored, np.eye(found.rates.size), atol=1e-12)
    assert found.rates.size < 0.4 * problem.capacity.size


@pytest.mark.long
def test_four_times_the_contact_elements_take_far_less_than_four_times_the_modes():
    """Neighbours act alike: what they share is taken once."""
    structure = two_bars(left=(4, 8, 8), right=(4, 8, 8))
    ranks = []
    for grid in ((4, 4), (8, 8)):
        bars = assemble(
            structure,
            fixed=["left_end", "right_end"],
            grid=grid,
            convection={"bottom": 50.0},
            sources={"left_top": 1.0},
        )
        parts = bars.parts
        rows = probe_rows(parts.spaces.heat, structure, structure.probes)
        modes = thermal_modes(
            parts.heat, parts.operators, outputs_of(bars.machine.contact.elastic, rows), 2.0
        )
        assert modes.error <= 1.0
        ranks.append(modes.rates.size)
    assert ranks[1] < 2.6 * ranks[0]
    # Every input at every shift would be 20 x (64 + 2).
    assert ranks[1] < 0.3 * 20 * 66


# --- whatever the structure ----------------------------------------------------------------------


@st.composite
def chains(draw):
    """Random capacities in a row, conductances between them, films on some; two places heated."""
    count = draw(st.integers(20, 60))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    capacity = 10.0 ** rng.uniform(0.0, 4.0, count)
    between = 10.0 ** rng.uniform(-2.0, 2.0, count - 1)
    convection = (
        draw(st.sampled_from([0.0, 1.0]))
        * rng.choice([0.0, 1.0], count)
        * 10.0 ** rng.uniform(-3.0, 0.0, count)
    )
    diagonal = convection.copy()
    diagonal[:-1] += between
    diagonal[1:] += between
    matrix = diags_array([diagonal, -between, -between], offsets=[0, 1, -1], format="csr")
    places = rng.choice(count, 3, replace=False)
    unit = np.eye(count)[places]
    drives = 100.0 * np.column_stack([unit[0], unit[1] - unit[2]])
    return Problem(capacity, csr_array(matrix), drives, unit / 1e-2), convection


@settings(max_examples=25, deadline=None)
@given(chains())
def test_a_reduced_model_never_grows_by_itself_and_loses_no_heat(chain):
    problem, convection = chain
    found = problem.reduce()
    assert found.rates.min() >= 0.0
    levels = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 2))
    for step in (1.0, 50.0):
        _, states = problem.reduced_march(found, step, levels)
        field = states @ found.basis.T
        given_heat = problem.drives.sum(axis=0) @ levels.T
        before = np.vstack([np.zeros(field.shape[1]), field[:-1]])
        stored = (field - before) / step * problem.capacity
        left = given_heat - stored.sum(axis=1) - field @ convection
        moved = np.abs(stored).sum(axis=1) + np.abs(field) @ convection
        np.testing.assert_array_less(np.abs(left), 1e-9 * moved)


def test_many_inputs_are_sampled_and_each_is_checked():
    """More contact elements than a sample has columns: the error is still that of every one."""
    parts = conduct(
        two_bars(left=(3, 5, 5), right=(3, 5, 5)),
        convection={"bottom": 50.0},
        sources={"left_top": 1.0},
        grid=(6, 6),
    )
    jump = parts.operators.jump.toarray()
    problem = Problem(
        parts.heat.capacity.diagonal(),
        csr_array(parts.heat.conduction + parts.heat.convection),
        np.hstack([1e3 * parts.heat.inputs[:, :1], 1e3 / len(jump) * jump.T]),
        jump / TEMPERATURE_ERROR,
    )
    each = problem.reduce()
    sampled = problem.reduce(sample=8)
    assert max(each.error, sampled.error) <= 1.0
    levels = np.random.default_rng(5).uniform(-1.0, 1.0, (60, problem.drives.shape[1]))
    size = np.abs(levels).sum(axis=1).max()
    off = problem.march(2.0, levels) - problem.reduced_march(sampled, 2.0, levels)[0]
    assert np.abs(off).max() <= max(sampled.error, 0.1) * size
