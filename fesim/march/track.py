"""Arrays of the results of many steps, computed by JIT-compiled code if possible.

A `Track` contains several `Step`s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fesim.march.heat_step import heat_balances
from fesim.march.machine import CondensedMachine, State, Step
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

if TYPE_CHECKING:
    from fesim.march.compiled_march import Kept, Record
    from fesim.march.kernel import StepKernel


@dataclass(frozen=True, eq=False)
class Track:
    """n consecutive steps: arrays are as in `Step` and `State`, with n as their first dimension."""

    #: Number of steps taken at the end of each.
    index: NDArray[np.int64]
    inputs: Array
    conductance: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: Array
    iterations: NDArray[np.int64]
    cuts: NDArray[np.int64]
    heat_balance: Array
    secant_residual: Array
    temperature: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    differences: Array
    frozen: Array
    turning: Array
    parts: NDArray[np.int64]
    drive: Array
    model: str

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.index)

    def step(self, at: int) -> Step:
        """Return one of the steps."""
        state = State(
            index=int(self.index[at]),
            temperature=self.temperature[at],
            gap=self.gap[at],
            slip=self.slip[at],
            pressure=self.pressure[at],
            change=self.change[at],
            differences=self.differences[at],
            model=self.model,
            frozen=self.frozen[at],
            turning=self.turning[at],
            parts=int(self.parts[at]),
            drive=self.drive[at],
        )
        return Step(
            state=state,
            inputs=self.inputs[at],
            conductance=self.conductance[at],
            heat_flow=self.heat_flow[at],
            displacement=self.displacement[at],
            remainder=self.remainder[at],
            residual=float(self.residual[at]),
            iterations=int(self.iterations[at]),
            cuts=int(self.cuts[at]),
            heat_balance=float(self.heat_balance[at]),
            secant_residual=float(self.secant_residual[at]),
        )


#: Names of its arrays.
_ARRAYS = tuple(one.name for one in fields(Track) if one.name != "model")


def track_of(step: Step) -> Track:
    """Return a track of one step."""
    values = vars(step) | vars(step.state)
    arrays = {name: np.asarray(values[name])[None] for name in _ARRAYS}
    return Track(**arrays, model=step.state.model)


def first_of(track: Track, count: int) -> Track:
    """Return the first steps of a track."""
    if count == len(track):
        return track
    return replace(track, **{name: getattr(track, name)[:count] for name in _ARRAYS})


def joined(tracks: Sequence[Track]) -> Track:
    """Return consecutive tracks as one."""
    arrays = {name: np.concatenate([getattr(track, name) for track in tracks]) for name in _ARRAYS}
    return Track(**arrays, model=tracks[0].model)


def kernel_march(machine: CondensedMachine) -> Callable[[State, Array], Track | None] | None:
    """Start a compiled march; None if a law, the thermal model or frictional heat is unsupported.

    The returned function takes a state and inputs (n, k + l), and returns the steps before a joint
    snaps or a body comes loose; None if that happens in the first one.
    """
    if not machine.contact.count or machine.friction or machine.stiffness:
        return None
    # Imported here because it loads a compiler, which structures without joints do not need.
    from fesim.march.kernel import new_kept, step_kernel

    kernel = step_kernel(machine)
    if kernel is None:
        return None
    return partial(_kernel_track, machine, kernel, new_kept(kernel.machine, kernel.blocks))


def _kernel_track(
    machine: CondensedMachine, kernel: StepKernel, kept: Kept, state: State, inputs: Array
) -> Track | None:
    record, taken, loose = kernel.run(kept, state, inputs)
    if loose and _came_loose(machine, state.slip if taken == 1 else record.slip[-2], record):
        # The plain step raises the error; the steps before it are valid.
        record, taken = type(record)._make(column[:-1] for column in record), taken - 1
    if not taken:
        return None
    thermal, inputs = machine.thermal, inputs[:taken]
    before = np.vstack([state.temperature, record.amplitudes[:-1]])
    known = inputs[:, : thermal.inputs.shape[1]]
    return Track(
        index=state.index + 1 + np.arange(taken),
        inputs=inputs,
        conductance=record.conducted / machine.contact.elastic.area[: machine.contact.count],
        heat_flow=record.heat_flow,
        displacement=record.displacement,
        remainder=record.remainder,
        residual=record.residual,
        iterations=record.iterations,
        cuts=np.zeros(taken, dtype=np.int64),
        heat_balance=heat_balances(thermal, before, record.amplitudes, known, record.heat_flow),
        secant_residual=np.zeros(taken),
        temperature=record.amplitudes,
        gap=record.gap,
        slip=record.slip,
        pressure=record.pressure,
        change=record.change,
        differences=record.differences,
        frozen=record.frozen,
        turning=np.broadcast_to(state.turning, (taken, *state.turning.shape)),
        parts=np.broadcast_to(state.parts, taken),
        drive=np.broadcast_to(state.drive, (taken, state.drive.size)),
        model=state.model,
    )


def _came_loose(machine: CondensedMachine, slip: Array, record: Record) -> bool:
    """Whether a body is loose after the last recorded step; `slip` (2, m) is that at its start."""
    if machine.contact.watch is None:
        return False
    tangent = machine.contact.traction(record.gap[-1], slip).tangent
    try:
        machine.contact.watch.check(record.pressure[-1], tangent)
    except ConvergenceError:
        return True
    return False
