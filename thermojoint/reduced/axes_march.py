"""Known inputs marched along several axes: the compiled steps of the simulator on reduced modes.

`fesim.axes.compiled_march` takes modes that have nothing of the exchange between pads and guides
(`calibrate.joint_aware.misfit.physics_with`). One axis has a march of its own (`guided_march`),
whose modes have that exchange in the mean.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from fesim.axes.axis import Axis
from fesim.axes.compiled_drive import drives_of
from fesim.axes.compiled_march import AxesKernel, AxesState, AxesSteps, AxesWork, march_axes
from fesim.axes.compiled_passing import Ways, guides_of
from fesim.axes.corner_table import CornerTables, around
from fesim.axes.guideway import Guideway
from fesim.axes.kernel import axes_work, new_record
from fesim.axes.row_blocks import body_rows
from fesim.axes.survey import new_here, pads_of
from fesim.case.history import History
from fesim.joint.compiled_gap import trial_at
from fesim.joint.loosening import UNWATCHED
from fesim.march.compiled_march import Moving
from fesim.march.compiled_step import HeatStep, JointKernel, JointState
from fesim.march.contact import ContactProblem
from fesim.march.kernel import owned
from fesim.march.passing import Rows
from thermojoint.artefacts.arrays import Array

#: Steps whose places are tied together.
AT_ONCE = 64
#: The screws of a reduced machine are apart from it (`axis_drive`).
_UNDRIVEN = Axis(
    "", History(np.zeros(1), np.zeros(1)), np.zeros(0), 0.0, drive=None, carried=np.zeros(3)
)


class ReducedAxesMarch(NamedTuple):
    """A compiled march, and its storage."""

    #: Of the guideway.
    tables: CornerTables
    kernel: AxesKernel
    work: AxesWork


def reduced_axes_march(
    heat: HeatStep,
    way: Guideway,
    joint: JointKernel,
    contact: ContactProblem,
    tables: CornerTables,
    length: float,
) -> ReducedAxesMarch:
    """Return the march of a machine on axes.

    Parameters
    ----------
    heat : HeatStep
        Of its steps; its influences are those of the guideway's q rows.
    way : Guideway
        On the modes.
    joint : JointKernel
        At the first positions.
    contact : ContactProblem
        The same.
    tables : CornerTables
        Of the guideway.
    length : float
        Of a step, s.
    """
    axes, (modes, _) = len(way.stations.positions), heat.drive.shape
    rows = Rows(way.temperature, heat.influence.T, heat.joint_influence)
    blocks, count = body_rows(rows, way.elastic.thermal), joint.preload.size
    kernel = AxesKernel(
        # The last inputs of the simulator count the heat of friction.
        heat._replace(drive=np.hstack([heat.drive, np.zeros((modes, axes))])),
        guides_of(way.stations, blocks, heat.joint_influence),
        drives_of([_UNDRIVEN] * axes, modes),
        joint,
        pads_of(tables, contact, joint.laws, np.zeros((2, count))),
        blocks.untied,
        blocks.warmed,
        owned(way.running / length),
        owned(contact.reference_pressure),
        UNWATCHED,
        1,
        length,
    )
    probes = len(contact.elastic.probe_compliance)
    here = new_here(tables.held, probes, trial_at(np.zeros((3, count))))
    return ReducedAxesMarch(tables, kernel, axes_work(kernel, here, 0, len(way.elastic.thermal)))


def march_along(
    march: ReducedAxesMarch, inputs: Array, first: int, now: Moving, record: tuple[Array, Array]
) -> int:
    """March through inputs, into a record of amplitudes (n, r) and displacements (n, axes), m.

    Parameters
    ----------
    march : ReducedAxesMarch
        The machine.
    inputs : ndarray, shape (n, k + 3 x)
        Heat and temperatures of each step, then the positions of x axes at its start and end, and
        how far each has gone, m.
    first : int
        Which step of the march the first one is.
    now : Moving
        Amplitudes and joints, in place.
    record : tuple of ndarray, shapes (n, r) and (n, axes)
        After each step.

    Returns
    -------
    int
        Number of steps taken: fewer than n if the plain method must take the next one, or the
        places of more are to be tied; `now` is before it then.
    """
    tables, kernel, work = march
    axes, some = len(tables.guideway.stations.positions), inputs[:AT_ONCE]
    known = inputs.shape[1] - 3 * axes
    starts, ends, gone = np.split(some[:, known:], 3, axis=1)
    near, count = around(tables.guideway.stations, ends), len(some)
    steps = AxesSteps(
        first,
        owned(np.hstack([some[:, :known], np.zeros((count, axes))])),
        Ways(
            np.tile(np.arange(count + 1.0), axes),
            np.vstack([starts[:1], ends]).T.ravel(),
            (count + 1) * np.arange(axes)[:, None] + np.arange(count + 1),
            owned(np.maximum(gone - np.abs(ends - starts), 0.0).T),
        ),
        tables.table(near.corners),
        near.touched,
        near.weight,
        np.empty((len(near.corners), work.here.free.size)),
    )
    kernel.pads.slip[:] = now.joint.slip
    joint = JointState(*map(owned, now.joint))._replace(slip=kernel.pads.slip)
    state = AxesState(now.amplitudes.copy(), joint, np.zeros((3, joint.pressure.size)), np.zeros(0))
    found, taken = new_record(work, count), 0
    with suppress(np.linalg.LinAlgError):
        taken = march_axes(kernel, work, steps, state, found)
    if not taken:
        return 0
    record[0][:taken], record[1][:taken] = found.amplitudes[:taken], found.displacement[:taken]
    last = taken - 1
    now.amplitudes[:] = found.amplitudes[last]
    for name in JointState._fields:
        getattr(now.joint, name)[:] = getattr(found, name)[last]
    return taken
