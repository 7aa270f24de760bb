"""Known inputs marched along axes: the compiled steps of the simulator on reduced modes.

`fesim.axes.compiled_march` takes modes without the exchange between pads and guides
(`calibrate.joint_aware.misfit.physics_with`). One axis without a drive has a march of its own
(`guided_march`), whose modes include the mean of that exchange.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fesim.axes.axis import Axis
from fesim.axes.compiled_march import AxesKernel, AxesState, AxesSteps, AxesWork
from fesim.axes.compiled_passing import Ways
from fesim.axes.corner_table import CornerTables, around
from fesim.axes.kernel import axes_kernel, march_into
from fesim.axes.kernel import new_record as new_steps
from fesim.axes.row_blocks import body_rows
from fesim.case.history import History
from fesim.march.compiled_step import HeatStep, JointState
from fesim.march.contact import ContactProblem
from fesim.march.kernel import owned
from fesim.march.passing import Rows
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Modes

#: Number of steps whose places are tied at once.
AT_ONCE = 64


class ReducedMarch(NamedTuple):
    """A compiled march, and its storage."""

    #: Of the guideway.
    tables: CornerTables
    kernel: AxesKernel
    work: AxesWork
    #: Number of inputs that are known before a step: the heat of drives and of friction is not.
    known: int


class Record(NamedTuple):
    """n steps; the last four are as in `JointState`."""

    #: Shape (n, r).
    amplitudes: Array
    #: Shape (n, d): temperatures of the drives, K.
    drive: Array
    #: Shape (n, p): displacement probes, m.
    probes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array


def new_record(steps: int, first: tuple[Array, Array], probes: int, joint: JointState) -> Record:
    """Return storage for some steps from amplitudes (r,), drives (d,) and joints on, p probes."""
    shapes = [*(one.shape for one in first), (probes,), *(one.shape for one in joint)]
    return Record(*(np.full((steps, *shape), np.nan) for shape in shapes))


def reduced_march(
    heat: HeatStep, modes: Modes, contact: ContactProblem, tables: CornerTables, length: float
) -> ReducedMarch | None:
    """Return the march of a machine on axes; None if a law is not built in.

    Parameters
    ----------
    heat : HeatStep
        Of its steps; its influences are those of the guideway's q rows.
    modes : Modes
        Of the machine, with the guideway and the drives.
    contact : ContactProblem
        The joints at the first positions.
    tables : CornerTables
        Of the guideway.
    length : float
        Of a step, s.
    """
    way, drives = modes.way, modes.drives
    assert way is not None  # with axes
    assert drives is not None
    known = modes.drive.shape[1]
    rows = Rows(way.temperature, heat.influence.T, heat.joint_influence)
    axes = [
        Axis("", History(np.zeros(1), np.zeros(1)), np.zeros(0), 0.0, drive, np.zeros(3))
        for drive in drives.driving(known - 1, known)
    ]
    # The last inputs of the simulator count the heat of friction.
    counted = heat._replace(drive=np.pad(heat.drive, ((0, 0), (0, len(axes)))))
    blocks = body_rows(rows, way.elastic.thermal)
    made = axes_kernel(counted, contact, tables, blocks, axes, length)
    return None if made is None else ReducedMarch(tables, *made, known)


def march_along(
    march: ReducedMarch,
    inputs: Array,
    first: int,
    now: tuple[tuple[Array, Array], JointState],
    record: Record,
) -> int:
    """March through inputs, into a record.

    Parameters
    ----------
    march : ReducedMarch
        The machine.
    inputs : ndarray, shape (n, k + 3 x)
        Heat and temperatures of each step, then the positions of x axes at its start and end, and
        the travel of each, m.
    first : int
        Index of the first one in the march.
    now : tuple
        Amplitudes (r,) with temperatures of the drives (d,), K, and joints, in place.
    record : Record
        After each step.

    Returns
    -------
    int
        Number of steps taken: fewer than n if the next one needs the plain method, or the places of
        more steps must be tied; `now` is then the state before it.
    """
    tables, kernel, work, known = march
    (amplitudes, drive), moving = now
    axes, some = len(tables.guideway.stations.positions), inputs[:AT_ONCE]
    starts, ends, gone = np.split(some[:, known:], 3, axis=1)
    near, count = around(tables.guideway.stations, ends), len(some)
    unknown = kernel.heat.drive.shape[1] - known
    steps = AxesSteps(
        first,
        owned(np.pad(some[:, :known], ((0, 0), (0, unknown)))),
        Ways(
            np.tile(kernel.length * np.arange(count + 1.0), axes),
            np.vstack([starts[:1], ends]).T.ravel(),
            (count + 1) * np.arange(axes)[:, None] + np.arange(count + 1),
            owned(np.maximum(gone - np.abs(ends - starts), 0.0).T),
        ),
        tables.table(near.corners),
        near.touched,
        near.weight,
        np.empty((len(near.corners), work.here.free.size)),
    )
    kernel.pads.slip[:] = moving.slip
    joint = JointState(*map(owned, moving))._replace(slip=kernel.pads.slip)
    turning = np.zeros((3, joint.pressure.size))
    state = AxesState(amplitudes.copy(), joint, turning, drive.copy())
    found = new_steps(work, count)
    taken = march_into(found, kernel, work, steps, state)
    if not taken:
        return 0
    record.amplitudes[:taken], record.drive[:taken] = found.amplitudes[:taken], found.drive[:taken]
    record.probes[:taken] = found.displacement[:taken]
    last = taken - 1
    amplitudes[:], drive[:] = found.amplitudes[last], found.drive[last]
    for name in JointState._fields:
        getattr(record, name)[:taken] = getattr(found, name)[:taken]
        getattr(moving, name)[:] = getattr(found, name)[last]
    return taken
