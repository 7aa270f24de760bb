"""Displacements at other positions than those of the axes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fesim.axes.corner_table import CornerTables, around
from fesim.axes.guideway import Place
from fesim.axes.machine import MovingMachine
from fesim.march.contact import ContactProblem
from fesim.march.machine import Step
from fesim.march.settling import displaced, settle_along
from fesim.one_thread import one_thread
from thermojoint.artefacts.arrays import Array

#: Largest number of numbers in the combinations of one sweep: 0.4 GB.
AT_ONCE = 50_000_000


class Seen(NamedTuple):
    """State of joints and probes at c places in one thermal state."""

    #: Shape (c, p): displacement probes, m.
    displacement: Array
    #: Shape (c,): largest error of the gaps, m.
    residual: Array


def seen_from(moving: MovingMachine, step: Step, places: Sequence[Place]) -> Seen:
    """Return the displacements if the axes were at other positions at the end of a step.

    Temperatures and the history of friction are those of the step; the joints are settled there.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    step : Step
        A step of its march.
    places : sequence of tuple of float
        c times the position of every axis, m.

    Raises
    ------
    ConvergenceError
        There is no equilibrium there.
    """
    alone = moving.guideway.elastic.alone(step.state.temperature)
    contact, tables = moving.machine.contact, moving.tables
    joint = step.state.gap, step.state.slip
    # Threads busy-wait between small products: a first map took twelve times as long with two.
    with one_thread():
        found = surveyed(contact, tables, joint, alone, np.array(places))
        for at in np.flatnonzero(np.isnan(found.residual)).tolist():
            here = _settled_at(moving, step, alone, places[at])
            found.displacement[at], found.residual[at] = here
    return found


def surveyed(
    contact: ContactProblem,
    tables: CornerTables,
    joint: tuple[Array, Array],
    alone: Array,
    places: Array,
) -> Seen:
    """Return the displacements at all places from one sweep.

    The residual is NaN where it does not converge, and everywhere for laws that are not compiled.

    Parameters
    ----------
    contact : ContactProblem
        The joints, at the first positions.
    tables : CornerTables
        Tables of the same machine.
    joint : tuple of ndarray, shapes (3, m) and (2, m)
        Gaps and irreversible slips at the positions of the axes, m.
    alone : ndarray, shape (q + p,)
        Untied thermal displacements.
    places : ndarray, shape (n, axes)
        Positions, m.
    """
    # Imported here because they load a compiler, as in `fesim.march.contact.gap_solver`.
    from fesim.axes.survey import Survey, grown, new_here, pads_of, settle_all
    from fesim.joint.compiled_gap import compile_gap, trial_at

    nothing = np.full(len(places), np.nan)
    probes = len(contact.elastic.probe_compliance)
    seen = Seen(np.empty((len(places), probes)), nothing)
    law = compile_gap(contact.gap_problem, contact.laws)
    if law is None or not len(places):
        return seen
    near = around(tables.guideway.stations, places)
    if len(places) > 1 and len(near.corners) * tables.each > AT_ONCE:
        parts = np.array_split(places, 2)
        halves = (surveyed(contact, tables, joint, alone, part) for part in parts)
        return Seen(*map(np.concatenate, zip(*halves, strict=True)))
    table, held = tables.table(near.corners), tables.held
    pads = pads_of(tables, contact, law.laws, joint[1])
    free = np.empty((len(near.corners), held.size + probes))
    grown(table, pads, alone, free)
    found = Survey(*seen, np.empty((len(places), held.size)))
    # One layout, for which the sweep is compiled once.
    around_each = np.ascontiguousarray(places), near.touched, np.ascontiguousarray(near.weight)
    here = new_here(held, probes, trial_at(joint[0]))
    # Places not reached are left to the plain method: a tangent may be singular in single
    # precision.
    with suppress(np.linalg.LinAlgError):
        settle_all(table, pads, free, around_each, here, found)
    return seen


def _settled_at(moving: MovingMachine, step: Step, alone: Array, at: Place) -> tuple[Array, float]:
    there = replace(step.state, change=np.zeros_like(step.state.change))
    free = moving.guideway.free_at(at, alone)
    machine = replace(moving.machine, contact=moving.settling(at))
    settled, _ = settle_along(machine.contact, there, free[: there.gap.size])
    return displaced(machine, free, settled, step.inputs)[1], settled.residual
