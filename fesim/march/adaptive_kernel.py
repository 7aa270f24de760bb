"""Data of a condensed machine for the JIT-compiled adaptive march, if supported."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fesim.joint.compiled_gap import newton_work, trial_at
from fesim.joint.loosening import watch_work
from fesim.march.adaptive_state import Asked, Effort, Now, Passed, Solving, StepEnds
from fesim.march.compiled_adaptive import (
    AFTER,
    ALL,
    BEFORE,
    THIS,
    WEIGHTS,
    AdaptiveKernel,
    Course,
    Rows,
    Storage,
    Taken,
    Work,
    march_freely,
)
from fesim.march.compiled_adaptive import Asked as CompiledAsked
from fesim.march.compiled_exponential import Lengths, Modes, new_lengths
from fesim.march.exponential import heat_spread
from fesim.march.heat_step import heat_balances
from fesim.march.iteration import left_open
from fesim.march.kernel import joint_kernel, owned, watched_in
from fesim.march.machine import CondensedMachine, State
from fesim.march.step_control import LONGEST, Pace, StepError
from fesim.march.track import Track
from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array

#: Maximum number of steps per call.
BLOCK = 128
#: As in `fesim.joint.compiled_gap.GapKernel`.
LEFT = 0.05


@dataclass(frozen=True, eq=False)
class FreeMarch:
    """A compiled adaptive march."""

    #: The simulated machine.
    machine: CondensedMachine
    #: Its data.
    kernel: AdaptiveKernel
    #: Work arrays, written in place.
    storage: Storage

    def run(self, now: Now, asked: Asked, index: int) -> tuple[Track | None, Passed, bool]:
        """Advance the march by `BLOCK` steps at most.

        Parameters
        ----------
        now : Now
            The march so far.
        asked : Asked
            Inputs, tolerance and the remaining times.
        index : int
            Index of the first of these times.

        Returns
        -------
        track : Track or None
            The machine at the times that were passed; None if there are none.
        passed : Passed
            The march after the steps.
        usual : bool
            False if the plain march must take the next step.
        """
        course = self._course(now)
        within = np.searchsorted(asked.times, now.time + LONGEST, side="right")
        rows = _new_rows(course, min(len(asked.times), max(BLOCK, int(within))))
        taken, tolerance, drive = _new_steps(course), asked.tolerance, asked.drive
        what = CompiledAsked(
            owned(asked.times),
            owned(asked.knots),
            owned(drive.times),
            owned(drive.values),
            np.array([tolerance.displacement, tolerance.temperature, tolerance.followed]),
        )
        steps, count, usual = march_freely(self.kernel, self.storage, course, what, rows, taken)
        rows = Rows._make(column[:count] for column in rows)
        taken = Taken._make(column[:steps] for column in taken)
        solving, residual, balance, iterations = self._solved(now, taken, count)
        after = _after(now, course, solving)
        effort = after.effort
        times, size = now.time + np.cumsum(taken.numbers[:, 0]), 3 * len(now.flow)
        ends = StepEnds(times, taken.unknowns, taken.joint[:, :size], taken.joint[:, size:])
        if count == len(asked.times):
            last = StepError(course.moved[THIS], course.warmed[THIS])
            effort = effort.with_step(float(taken.numbers[-1, 0]), last, 0)
        if not count:
            return None, Passed(effort, after, ends), usual
        area, state = self.machine.contact.elastic.area[: rows.gap.shape[2]], now.state
        still = np.zeros((7, rows.gap.shape[2]))
        track = Track(
            index=index + np.arange(count),
            inputs=drive(asked.times[:count]),
            conductance=rows.contact[:, 1] / area,
            heat_flow=rows.contact[:, 2],
            displacement=rows.displacement,
            remainder=rows.remainder,
            residual=residual,
            iterations=iterations,
            cuts=np.zeros(count, dtype=np.int64),
            heat_balance=balance,
            secant_residual=np.zeros(count),
            temperature=rows.unknowns,
            gap=rows.gap,
            slip=rows.slip,
            pressure=rows.contact[:, 0],
            change=np.broadcast_to(still[:3], (count, 3, still.shape[1])),
            differences=np.broadcast_to(state.differences, (count, *state.differences.shape)),
            frozen=np.broadcast_to(still, (count, *still.shape)),
            turning=np.broadcast_to(state.turning, (count, *state.turning.shape)),
            parts=np.broadcast_to(state.parts, count),
            drive=np.broadcast_to(state.drive, (count, state.drive.size)),
            model=state.model,
        )
        return track, Passed(effort, after, ends), usual

    def _course(self, now: Now) -> Course:
        """The march so far, copied into new arrays."""
        state, pace, effort = now.state, now.pace, now.effort
        counts = (effort.steps, effort.rejected, effort.shortest, effort.longest)

        def pair(values: Array) -> Array:
            return np.array([values, values], dtype=np.float64)

        return Course(
            unknowns=pair(state.temperature),
            acting=np.zeros((2, state.temperature.size)),
            gap=pair(state.gap),
            slip=pair(state.slip),
            pressure=pair(state.pressure),
            change=pair(state.change),
            flow=pair(now.flow),
            inputs=pair(now.inputs),
            slope=np.array(now.slope),
            clock=np.array(
                [now.time, 0.0, 0.0, now.length, pace.length, pace.error, 0.0, pace.way, 0.0]
            ),
            effort=np.array([*counts, effort.displacement, effort.temperature]),
            moved=pair(effort.sum.displacement),
            warmed=pair(effort.sum.temperature),
        )

    def _solved(
        self, now: Now, taken: Taken, count: int
    ) -> tuple[Solving, Array, Array, np.ndarray]:
        """Solver figures of the steps after the last row, and up to each of the rows.

        For each row: residual, heat balance and iterations.
        """
        thermal, solving = self.machine.thermal, now.solving
        length, residuals, iterations, ends = taken.numbers.T
        before = np.vstack([now.state.temperature, taken.unknowns[:-1]])[: len(length)]
        change = thermal.step / length[:, None] * (taken.unknowns - before)
        known = taken.inputs[:, : thermal.inputs.shape[1]]
        balances = heat_balances(thermal, taken.mean - change, taken.mean, known, taken.flow)
        of_rows, needed, given = np.empty((2, count)), np.zeros(count, dtype=np.int64), 0
        said = zip(
            residuals.tolist(), balances.tolist(), iterations.astype(int).tolist(), strict=True
        )
        for own, end in zip(said, ends.astype(int).tolist(), strict=True):
            solving = solving.and_of(Solving(*own))
            if end > given:
                of_rows[:, given:end] = [[solving.residual], [solving.heat_balance]]
                needed[given] = solving.iterations
                given, solving = end, Solving()
        return solving, of_rows[0], of_rows[1], needed


def _after(now: Now, course: Course, solving: Solving) -> Now:
    """The march after some steps."""
    time, _, _, length, planned, error, _, way, _ = map(float, course.clock)
    steps, rejected, *others = map(float, course.effort)
    shortest, longest, moved, warmed = others
    total = StepError(course.moved[ALL], course.warmed[ALL])
    state: State = replace(
        now.state,
        temperature=course.unknowns[BEFORE],
        gap=course.gap[BEFORE],
        slip=course.slip[BEFORE],
        pressure=course.pressure[BEFORE],
        change=course.change[BEFORE],
    )
    return Now(
        time=time,
        state=state,
        inputs=course.inputs[BEFORE],
        flow=course.flow[BEFORE],
        slope=course.slope,
        length=length,
        pace=Pace(planned, error, way),
        effort=Effort(int(steps), int(rejected), shortest, longest, total, moved, warmed),
        solving=solving,
    )


def free_march(machine: CondensedMachine, rates: Array) -> FreeMarch | None:
    """Start a compiled adaptive march; None if the machine is not supported.

    Parameters
    ----------
    machine : CondensedMachine
        With the modes of a reduced thermal model.
    rates : ndarray, shape (r,)
        Decay rates of the modes, 1/s.
    """
    thermal, contact = machine.thermal, machine.contact
    if not contact.count or machine.friction or machine.stiffness:
        return None
    joint = joint_kernel(contact, np.asarray(thermal.jump), np.zeros(contact.count))
    if joint is None:
        return None
    modes, lengths = _heat_of(thermal, rates.tobytes())
    kernel = AdaptiveKernel(
        modes=modes,
        joint=joint._replace(left=LEFT),
        watched=watched_in(contact),
        mean=owned(np.asarray(thermal.mean)),
        scale=owned(contact.reference_pressure),
        left_open=left_open(machine),
        spread=heat_spread(thermal, rates),
    )
    return FreeMarch(machine, kernel, _storage(kernel, lengths))


@lru_cache(maxsize=1)
def _heat_of(thermal: ThermalCondensation, rates: bytes) -> tuple[Modes, Lengths]:
    """The heat equation and its weights, shared by marches with other laws and inputs.

    Stored weights depend on the step length only, so no march depends on earlier ones.
    """
    own = np.frombuffer(rates)
    drawn = np.array(np.asarray(thermal.jump).T, order="C", dtype=np.float64)
    drawn[len(own) :] = 0.0
    held = np.full(len(thermal.inputs) - len(own), np.inf)
    modes = Modes(np.concatenate([own, held]), owned(thermal.inputs), drawn)
    return modes, new_lengths(modes)


def _storage(kernel: AdaptiveKernel, lengths: Lengths) -> Storage:
    (size, count), axes = kernel.modes.drawn.shape, len(kernel.joint.free)
    work = Work(
        unknowns=np.zeros((WEIGHTS + 3, size)),
        contact=np.zeros((7, count)),
        slip=np.zeros((4, 2, count)),
        gap=np.zeros((5, 3, count)),
        remainder=np.zeros((2, 3 * count)),
        displacement=np.zeros((2, axes)),
        inputs=np.zeros(kernel.modes.inputs.shape[1] + kernel.joint.loaded.shape[1]),
        system=np.zeros((count, count)),
        pivots=np.zeros(count, dtype=np.int32),
        moved=np.zeros(axes),
        free_gap=np.zeros((2, 3 * count)),
        sweeps=np.zeros(3),
        turn=np.zeros(1, dtype=np.int64),
    )
    trial, newton = trial_at(np.zeros((3, count))), newton_work(count)
    return Storage(work, trial, newton, watch_work(kernel.watched), lengths)


def _new_rows(course: Course, count: int) -> Rows:
    size, contacts, axes = (
        one.shape[1] for one in (course.unknowns, course.pressure, course.moved)
    )
    return Rows(
        unknowns=np.empty((count, size)),
        gap=np.empty((count, 3, contacts)),
        slip=np.empty((count, 2, contacts)),
        contact=np.empty((count, 3, contacts)),
        remainder=np.empty((count, 3 * contacts)),
        displacement=np.empty((count, axes)),
    )


def _new_steps(course: Course) -> Taken:
    unknowns, inputs, flow = course.unknowns[AFTER], course.inputs[AFTER], course.flow[AFTER]
    return Taken(
        unknowns=np.empty((BLOCK, unknowns.size)),
        mean=np.empty((BLOCK, unknowns.size)),
        joint=np.empty((BLOCK, 4 * flow.size)),
        inputs=np.empty((BLOCK, inputs.size)),
        flow=np.empty((BLOCK, flow.size)),
        numbers=np.empty((BLOCK, 4)),
    )
