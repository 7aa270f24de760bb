"""Iterated coupling in a step: pressure and conductance at its end agree (docs/march.md).

Sweeps of heat and contact, weighted or accelerated; a step whose sweeps do not converge is taken in
halves.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from fesim.march.anderson import accelerated
from fesim.march.half_step import can_be_halved, halved, joined
from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.step import step_with
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Convergence limit: largest change of a pressure between sweeps, relative to the preload.
PRESSURE_TOLERANCE = 1e-9
#: Smallest and largest weight of a sweep, and the number of sweeps with Aitken weights.
WEIGHTS = 0.05, 10.0
SEEKING = 400
#: Weight of later sweeps.
RELAXING = 300 * (0.3,) + 400 * (0.1,) + 800 * (0.03,)
#: From this sweep on, agreement within the tolerance of the gap equations is sufficient.
PATIENCE = 20
#: Sweeps after which a step that can be halved is repeated with accelerated ones, the number of
#: these after which it is halved, and the largest number of halvings.
UNSETTLED, ACCELERATED, HALVINGS = 30, 60, 8
#: Largest change of a pressure in the shortest parts, relative to the preload, for a joint that
#: snaps between two values of the conductance.
SNAPS = 0.1


def divided_step(machine: CondensedMachine, state: State, inputs: Array, parts: int = 1) -> Step:
    """Take an iterated step, halved repeatedly if its sweeps do not converge.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    state : State
        State at the start of the step.
    inputs : ndarray, shape (k + l,)
        Inputs of the whole step.
    parts : int
        Smallest number of parts, a power of two.

    Raises
    ------
    ConvergenceError
        Pressure and heat flow do not agree even in the shortest part, or a part has no
        equilibrium.
    """
    return _divided(machine, state, inputs, HALVINGS, parts.bit_length() - 1)[0]


def _divided(
    machine: CondensedMachine, state: State, inputs: Array, halvings: int, least: int
) -> tuple[Step, int]:
    """Take an iterated step, halved repeatedly if its sweeps do not converge.

    Returns the step and the number of halvings of its shortest part, at least `least`: the second
    half of a step is not tried in longer parts than the first half needed.
    """
    if not can_be_halved(machine):
        return iterated_step(machine, state, inputs), 0
    if not halvings:
        few = Sweeps(seeking=UNSETTLED, relaxing=(), snaps=SNAPS)
        with suppress(_UnsettledError):
            return iterated_step(machine, state, inputs, few), 0
        return iterated_step(machine, state, inputs, Sweeps(snaps=SNAPS)), 0
    if not least:
        for seeking, accelerating in ((UNSETTLED, 0), (0, ACCELERATED)):
            with suppress(_UnsettledError):
                return iterated_step(machine, state, inputs, Sweeps(seeking, (), accelerating)), 0
    shorter = halved(machine)
    first, needed = _divided(shorter, state, inputs, halvings - 1, max(least - 1, 0))
    begun = replace(first.state, index=state.index)
    second, deepest = _divided(shorter, begun, inputs, halvings - 1, needed)
    return joined(first, second), 1 + deepest


class _UnsettledError(ConvergenceError):
    """Pressure and heat flow of a step have not converged after all sweeps."""


@dataclass(frozen=True)
class Sweeps:
    """Sweeps that determine the carried quantity, one kind after the other."""

    #: Number of sweeps with weights by Aitken's method.
    seeking: int = SEEKING
    #: Weights of further sweeps.
    relaxing: tuple[float, ...] = RELAXING
    #: Number of sweeps with Anderson acceleration.
    accelerating: int = 0
    #: Largest change of a pressure, relative to the preload, for which the best sweep is accepted
    #: if none converges.
    snaps: float = 0.0


def iterated_step(
    machine: CondensedMachine, state: State, inputs: Array, sweeps: Sweeps = Sweeps()
) -> Step:
    """Take one step of `iterated`.

    Fixed-point iteration. Every sweep starts from the state at the start of the step, so that
    friction sees one increment only; the first uses the pressure of the state. If a joint snaps
    between two values of the conductance, no sweep converges: the one with the smallest change can
    be accepted, and then counts as at least one viscous step.

    Raises
    ------
    ConvergenceError
        The pressures still change after all sweeps.
    """
    carried = carried_by(machine, state)
    value = carried.of(state)
    weight, last = 1.0, np.zeros_like(value)
    iterations = cuts = 0
    taken: list[Array] = []
    misfits: list[Array] = []
    least, closest = np.inf, None
    weighted = sweeps.seeking + len(sweeps.relaxing)
    for sweep in range(weighted + sweeps.accelerating):
        step = step_with(machine, state, inputs, carried.conductance(value))
        iterations += step.iterations
        cuts += step.cuts
        after = carried.of(step.state)
        misfit = (after - value) / carried.scale
        change = float(np.abs(misfit).max(initial=0.0))
        enough = PRESSURE_TOLERANCE if sweep < PATIENCE else left_open(machine)
        # When the joint snaps, the pressure jumps: it cannot agree with the conductance before.
        if change <= enough or step.cuts > 0:
            return replace(step, iterations=iterations, cuts=cuts)
        if change < least:
            least, closest = change, step
        # First guess of the next sweep: equal gaps give equal pressures, while another guess would
        # keep changing them within the tolerance of the gap equations.
        state = replace(state, change=step.state.change)
        slow = change > 0.5 * float(np.abs(last).max(initial=0.0))
        ends = 0.5 * np.minimum(value, after), 2.0 * np.maximum(value, after)
        if sweep >= weighted:
            taken.append(value / carried.scale)
            misfits.append(misfit)
            value = np.clip(carried.scale * accelerated(taken, misfits), *ends)
            continue
        if sweep >= sweeps.seeking:
            weight = sweeps.relaxing[sweep - sweeps.seeking]
        elif slow:
            weight = _aitken(weight, last, misfit)
        last = misfit
        value = np.clip(value + weight * (after - value), *ends)
    if closest is not None and least <= sweeps.snaps:
        return replace(closest, iterations=iterations, cuts=cuts + 1)
    raise _UnsettledError(
        f"in-step iteration: pressure and heat flow drive each other: {change:.1e} of the preload "
        f"after {sweep + 1} sweeps; take a shorter march.step_s"
    )


@dataclass(frozen=True)
class Carried:
    """Quantity carried from one sweep of an in-step iteration to the next, m values."""

    #: Returns the quantity of a state.
    of: Callable[[State], Array]
    #: Returns the conductances from its values, W/(m2 K).
    conductance: Callable[[Array], Array]
    #: Shape (m,): scale of its changes.
    scale: Array


def carried_by(machine: CondensedMachine, state: State) -> Carried:
    """Pressures; or conductances, if they depend on openings or temperatures as well."""
    if machine.contact.conducts_by_pressure:
        pressures = machine.contact.reference_pressure
        return Carried(lambda settled: settled.pressure, machine.contact.conductance, pressures)
    given = machine.conductance_in(state)
    scale = np.where(given > 0.0, given, 1.0)
    return Carried(machine.conductance_in, lambda values: values, scale)


def left_open(machine: CondensedMachine) -> float:
    """Return ten times the gap tolerance as a pressure relative to the preload."""
    stiffness = machine.contact.gap_problem.springs[: machine.contact.count]
    left = 10.0 * machine.contact.tolerance * stiffness / machine.contact.reference_pressure
    return float(left.max(initial=PRESSURE_TOLERANCE))


def _aitken(weight: float, last: Array, misfit: Array) -> float:
    """Weight of the next sweep by Aitken's method (Irons & Tuck 1969), for slow convergence.

    Growing sweeps leave an unstable state; full steps lead to a stable one.
    """
    turn = misfit - last
    if last @ turn >= 0.0:
        return 1.0
    return float(np.clip(-weight * (last @ turn) / (turn @ turn), *WEIGHTS))
