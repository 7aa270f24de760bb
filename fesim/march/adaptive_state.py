"""State of an adaptive march between two steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fesim.case.history import Histories
from fesim.march.machine import State, Step
from fesim.march.step_control import ROUNDING, Pace, StepError, Tolerance
from thermojoint.artefacts.arrays import Array

#: Arrays of a state that are stored between two steps; count of the numbers before the arrays.
OF_STATE = ("temperature", "gap", "slip", "pressure", "change")
NUMBERS = 15


@dataclass(frozen=True)
class Effort:
    """Number and lengths of the steps of an adaptive march so far, and its estimated error."""

    #: Accepted and rejected steps.
    steps: int
    rejected: int
    #: Lengths of accepted steps, s.
    shortest: float
    longest: float
    #: Sum of the estimated errors of all steps, which partly cancel.
    sum: StepError
    #: Largest magnitudes of this sum so far, m and K.
    displacement: float
    temperature: float

    def with_step(self, length: float, error: StepError, rejected: int) -> Effort:
        """Return the effort after a further step of a length (s) and its rejected attempts."""
        total = self.sum + error
        moved, warmed = total.largest()
        return Effort(
            steps=self.steps + 1,
            rejected=self.rejected + rejected,
            shortest=min(self.shortest, length),
            longest=max(self.longest, length),
            sum=total,
            displacement=max(self.displacement, moved),
            temperature=max(self.temperature, warmed),
        )


def no_effort(axes: int, count: int) -> Effort:
    """Return the effort before the first step, for displacement probes and contact elements."""
    none = StepError(np.zeros(axes), np.zeros(2 * count))
    return Effort(0, 0, np.inf, 0.0, none, 0.0, 0.0)


@dataclass(frozen=True)
class Asked:
    """Request to a march."""

    #: Inputs as functions of time, s.
    drive: Histories
    #: Shape (k,): times at which steps end, ascending, s; the last one is infinite.
    knots: Array
    #: Shape (t,): times of the response, ascending, s.
    times: Array
    #: For half an hour.
    tolerance: Tolerance


class Solving(NamedTuple):
    """Solver figures of the steps since the last row of a response; fields as in `Step`."""

    residual: float = 0.0
    heat_balance: float = 0.0
    iterations: int = 0
    cuts: int = 0

    def and_of(self, later: Solving | Step) -> Solving:
        """Return the figures combined with those of a later step."""
        return Solving(
            max(self.residual, later.residual),
            max(self.heat_balance, later.heat_balance, key=abs),
            self.iterations + later.iterations,
            self.cuts + later.cuts,
        )


@dataclass(frozen=True)
class Now:
    """State of the march between two steps."""

    #: Time, s.
    time: float
    #: Temperatures, contact and friction.
    state: State
    #: Shapes (k + l,) and (m,): inputs and joint heat flows, W.
    inputs: Array
    flow: Array
    #: Shape (m,): rate of change of the flows in the last step, W/s.
    slope: Array
    #: Length of the last step, s; zero if `slope` does not predict the next step.
    length: float
    #: Step size control of the next step.
    pace: Pace
    #: Steps so far.
    effort: Effort
    #: Solver figures since the last row of the response.
    solving: Solving = field(default_factory=Solving)

    def packed(self, driven: Array) -> Array:
        """Return all fields as one array, as `fesim.march.machine.State` stores them.

        Parameters
        ----------
        driven : ndarray, shape (k + l,)
            Inputs at the time of that state.
        """
        effort, solving, total = self.effort, self.solving, self.effort.sum
        shortest = effort.shortest if effort.steps else 0.0
        numbers = [self.time, self.length, self.pace.length, self.pace.error, self.pace.way]
        numbers += [effort.steps, effort.rejected, shortest, effort.longest]
        numbers += [effort.displacement, effort.temperature]
        numbers += [solving.residual, solving.heat_balance, solving.iterations, solving.cuts]
        arrays = [self.inputs, self.flow, self.slope, total.displacement, total.temperature]
        arrays += [getattr(self.state, name).ravel() for name in OF_STATE]
        return np.concatenate([np.array(numbers, dtype=np.float64), *arrays, driven])


def unpacked(state: State, inputs: int, axes: int) -> tuple[Now, Array]:
    """Return the march stored in a state, and the inputs (k + l,) at its time.

    Parameters
    ----------
    state : State
        Of an adaptive march.
    inputs, axes : int
        Numbers of inputs and of displacement probes.
    """
    count, kept = state.pressure.size, state.course
    numbers, at = kept[:NUMBERS].tolist(), NUMBERS
    arrays = []
    shapes = [(inputs,), (count,), (count,), (axes,), (2 * count,)]
    for shape in [*shapes, *(getattr(state, name).shape for name in OF_STATE)]:
        size = math.prod(shape)
        arrays.append(kept[at : at + size].reshape(shape))
        at += size
    time, length, planned, error, way, steps, rejected, *others = numbers
    shortest, longest, moved, warmed, residual, balance, iterations, cuts = others
    temperature, gap, slip, pressure, change = arrays[5:]
    total = StepError(arrays[3], arrays[4])
    counts = int(steps), int(rejected), shortest if steps else np.inf, longest
    now = Now(
        time=time,
        state=replace(
            state, temperature=temperature, gap=gap, slip=slip, pressure=pressure, change=change
        ),
        inputs=arrays[0],
        flow=arrays[1],
        slope=arrays[2],
        length=length,
        pace=Pace(planned, error, way),
        effort=Effort(*counts, total, moved, warmed),
        solving=Solving(residual, balance, int(iterations), int(cuts)),
    )
    return now, kept[at:]


class StepEnds(NamedTuple):
    """The machine at the ends of s steps."""

    #: Shape (s,): times, s.
    times: Array
    #: Shapes (s, n), (s, 3 m) and (s, m): as in `fesim.march.machine.Step`.
    unknowns: Array
    remainder: Array
    pressure: Array

    def until(self, time: float) -> StepEnds:
        """Return the ends up to a time, s."""
        count = int(np.searchsorted(self.times, time * (1.0 + ROUNDING), side="right"))
        return StepEnds(*(each[:count] for each in self))


class Passed(NamedTuple):
    """An adaptive march after some of the requested times."""

    #: Steps up to the end of the last one.
    effort: Effort
    #: Where the march continues; after the last requested time, the start of the step with it.
    now: Now
    #: Ends of the steps taken.
    ends: StepEnds
