"""Data of a machine on axes for the JIT-compiled march, if supported.

It supports the same laws as `fesim.march.kernel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fesim.axes.axis import Axis, cold_drives
from fesim.axes.compiled_drive import drive_work, drives_of
from fesim.axes.compiled_march import (
    AxesKernel,
    AxesRecord,
    AxesState,
    AxesSteps,
    AxesWork,
    march_axes,
)
from fesim.axes.compiled_passing import Ways, guides_of, new_passed
from fesim.axes.corner_table import CornerTables, around
from fesim.axes.machine import MovingMachine
from fesim.axes.row_blocks import BodyRows
from fesim.axes.survey import Here, new_here, pads_of
from fesim.joint.compiled_gap import trial_at
from fesim.joint.loosening import watch_work
from fesim.march.compiled_step import HeatStep, JointState
from fesim.march.contact import ContactProblem
from fesim.march.heat_step import heat_balances
from fesim.march.kernel import joint_kernel, owned, watched_in
from fesim.march.machine import State
from fesim.march.track import Track
from thermojoint.artefacts.arrays import Array

#: Arrays that the repetition of a step has for itself: all but the matrices.
APART = ("free", "solved", "gap", "force", "residual", "correction", "before", "step")


@dataclass(frozen=True, eq=False)
class AxesMarch:
    """A compiled march and its work arrays."""

    #: The machine.
    moving: MovingMachine
    axes: Sequence[Axis]
    #: Data and work arrays of the compiled steps.
    kernel: AxesKernel
    work: AxesWork

    def take(self, state: State, inputs: Array) -> Track | None:
        """Take the steps with inputs (n, k), or the first of them.

        None if the plain method must take the first one: the joints have no equilibrium nearby, a
        body may have come loose, or steps may alternate.
        """
        kernel, thermal = self.kernel, self.moving.machine.thermal
        kernel.pads.slip[:] = state.slip
        own = [
            owned(array.copy())
            for array in (state.gap, state.pressure, state.change, state.temperature)
        ]
        joint = JointState(own[0], kernel.pads.slip, own[1], own[2])
        now = AxesState(own[3], joint, owned(state.turning.copy()), state.drive.copy())
        record = new_record(self.work, len(inputs))
        taken = march_into(record, kernel, self.work, self._steps(state.index, inputs), now)
        if not taken:
            return None
        record = AxesRecord._make(column[:taken] for column in record)
        area = self.moving.machine.contact.elastic.area[: kernel.scale.size]
        before = np.vstack([state.temperature, record.amplitudes[:-1]])
        return Track(
            index=state.index + 1 + np.arange(taken),
            inputs=record.inputs,
            conductance=record.conducted / area,
            heat_flow=record.heat_flow,
            displacement=record.displacement,
            remainder=record.remainder,
            residual=record.residual,
            iterations=record.iterations,
            cuts=np.zeros(taken, dtype=np.int64),
            heat_balance=heat_balances(
                thermal, before, record.amplitudes, record.inputs, record.heat_flow
            ),
            secant_residual=np.zeros(taken),
            temperature=record.amplitudes,
            gap=record.gap,
            slip=record.slip,
            pressure=record.pressure,
            change=record.change,
            differences=np.zeros((taken, *state.differences.shape)),
            frozen=np.zeros((taken, *state.frozen.shape)),
            turning=record.turning,
            parts=np.zeros(taken, dtype=np.int64),
            drive=record.drive,
            model=state.model,
        )

    def _steps(self, index: int, inputs: Array) -> AxesSteps:
        ends = (index + np.arange(len(inputs) + 1.0)) * self.moving.machine.thermal.step
        places = np.stack([axis.course(ends[1:]) for axis in self.axes], axis=1)
        near = around(self.moving.guideway.stations, places)
        return AxesSteps(
            index,
            owned(inputs),
            ways_of(self.axes, ends),
            self.moving.tables.table(near.corners),
            near.touched,
            near.weight,
            np.empty((len(near.corners), self.work.here.free.size)),
        )


def march_into(
    record: AxesRecord, kernel: AxesKernel, work: AxesWork, steps: AxesSteps, now: AxesState
) -> int:
    """March into a new record; return the number of steps before any singular tangent."""
    with suppress(np.linalg.LinAlgError):
        march_axes(kernel, work, steps, now, record)
    return int(np.count_nonzero(record.iterations >= 0))


def new_record(work: AxesWork, steps: int) -> AxesRecord:
    """Return storage for the results of steps."""
    count, probes = work.pressure.size, work.here.free.size - work.here.gap.size
    joint = [(3, count), (2, count), (count,), (3, count), (3, count)]
    before, after = [(work.driven.size,), (work.without.size,)], [(work.state.size,)]
    shapes = [*before, *joint, *after, (count,), (count,), (probes,), (3 * count,), ()]
    values: list[Any] = [np.empty((steps, *shape)) for shape in shapes]
    return AxesRecord(*values, *[np.full(steps, -1)])


def ways_of(axes: Sequence[Axis], ends: Array) -> Ways:
    """Return the travel of axes in the steps between times (n + 1,), s."""
    times, places, starts, size = [], [], [], 0
    for axis in axes:
        knots = axis.course.times
        own = np.union1d(ends, knots[(knots > ends[0]) & (knots < ends[-1])])
        times.append(own)
        places.append(axis.course(own))
        starts.append(size + np.searchsorted(own, ends))
        size += own.size
    none = np.zeros((len(axes), ends.size - 1))
    return Ways(np.concatenate(times), np.concatenate(places), np.array(starts), none)


def axes_march(moving: MovingMachine, axes: Sequence[Axis]) -> AxesMarch | None:
    """Return the compiled march of a machine, or None if it is not supported."""
    thermal, contact = moving.machine.thermal, moving.machine.contact
    if not contact.conducts_by_pressure or thermal.factor.solver != "diagonal":
        return None
    diagonal = thermal.factor.matrix.diagonal()
    heat = HeatStep(
        thermal.capacity_rate.diagonal() / diagonal,
        owned(thermal.inputs / diagonal[:, None]),
        np.zeros((0, 0)),
        owned(moving.rows.joint_influence),
    )
    made = axes_kernel(heat, contact, moving.tables, moving.blocks, axes, thermal.step)
    if made is None:
        return None
    kernel, work = made
    return AxesMarch(moving, axes, kernel._replace(copies=moving.copies), work)


def axes_kernel(
    heat: HeatStep,
    contact: ContactProblem,
    tables: CornerTables,
    blocks: BodyRows,
    axes: Sequence[Axis],
    length: float,
) -> tuple[AxesKernel, AxesWork] | None:
    """Return the data of a machine on axes, and work arrays; None if a law is not built in.

    Steps have a `length` (s), and `heat` the influence between the rows of the guideway; `contact`
    is that at the first positions.
    """
    count, way = contact.count, tables.guideway
    joint = joint_kernel(contact, np.zeros((count, 0)), np.zeros(count))
    if joint is None:
        return None
    kernel = AxesKernel(
        heat,
        guides_of(way.stations, blocks, heat.joint_influence),
        drives_of(axes, heat.decay.size),
        joint,
        pads_of(tables, contact, joint.laws, np.zeros((2, count))),
        blocks.untied,
        blocks.warmed,
        owned(way.running / length),
        owned(contact.reference_pressure),
        watched_in(contact),
        1,
        length,
    )
    probes = len(contact.elastic.probe_compliance)
    here = new_here(tables.held, probes, trial_at(np.zeros((3, count))))
    return kernel, axes_work(kernel, here, cold_drives(axes).size, len(way.elastic.thermal))


def axes_work(kernel: AxesKernel, here: Here, drives: int, untied: int) -> AxesWork:
    """Return work arrays for the given sizes of the drives' state and the untied displacements."""
    count, held = kernel.scale.size, kernel.pads.held.size
    rows, modes = len(kernel.guides.joint_influence), kernel.heat.decay.size
    own: dict[str, Any] = {name: np.zeros_like(getattr(here, name)) for name in APART}
    sizes = [held * (held + 1) // 2, (here.free.size - held) * held, count, modes, modes]
    more: list[Any] = [
        np.zeros(size)
        for size in (*sizes, count, rows, 3 * count, drives, kernel.heat.drive.shape[1])
    ]
    more.append(np.array([False, True]))
    return AxesWork(
        new_passed(kernel.guides),
        drive_work(kernel.drives),
        here,
        here._replace(trial=trial_at(np.zeros((3, count))), **own),
        watch_work(kernel.watched),
        np.zeros(untied),
        np.zeros(untied, dtype=np.bool_),
        *more,
    )
