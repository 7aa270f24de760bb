"""One time step on the modes: heat with the last conductance, then the gap equations.

The same equations as `fesim.march.stepping.staggered`, in two halves: between them the observer
corrects the temperatures. The conductance that the joint has at its preload belongs to the modes'
rates, so that the linear part of the machine is diagonal; only what goes beyond it is solved for
here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from fesim.joint.blocks import one_block
from fesim.joint.law import JointLaw
from fesim.joint.loosening import UNWATCHED
from fesim.march.compiled_march import MarchKernel, Moving, march_steps
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    JointState,
    conduct_step,
    heat_work,
    joint_work,
    settle_step,
)
from fesim.march.contact import ContactProblem
from fesim.march.kernel import joint_kernel, new_kept, new_record
from fesim.march.settling import settle_along
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Joint, Modes


@dataclass(frozen=True, eq=False)
class Physics:
    """A machine on the modes that diagonalise it with its joint at the preload.

    Attributes
    ----------
    modes : Modes
        With the joint held at its preload.
    laws : sequence of (JointLaw, int)
        The law of each joint and its number of contact elements.
    held : ndarray, shape (m,)
        Conductance times area that belongs to the modes, W/K.
    contact : ContactProblem
        Its gap equations: they do not see the heat.
    """

    modes: Modes
    laws: Sequence[tuple[JointLaw, int]]
    held: Array
    contact: ContactProblem

    @property
    def preload(self) -> Array:
        """Of every contact element, Pa."""
        return self.contact.preload

    @property
    def contacts(self) -> int:
        """Number of contact elements."""
        return self.held.size

    @cached_property
    def kernel(self) -> JointKernel | None:
        """Data of its compiled steps; None for laws that are not compiled."""
        return joint_kernel(self.contact, self.modes.jump, self.held) if self.contacts else None

    def at_rest(self) -> JointState:
        """Every joint at its preload."""
        count = self.contacts
        return JointState(
            np.zeros((3, count)),
            np.zeros((2, count)),
            self.preload.copy(),
            np.zeros((3, count)),
        )

    def beyond_preload(self, pressure: Array) -> Array:
        """Conductance times area that the modes do not have yet, W/K, shape (m,)."""
        area, start, parts = self.modes.elastic.area, 0, []
        for law, count in self.laws:
            at = slice(start, start + count)
            parts.append(law.conductance(pressure[at]) * area[at])
            start += count
        return np.concatenate([*parts]) - self.held if parts else np.empty(0)


def make_physics(modes: Modes, joints: Sequence[Joint], held: Array) -> Physics:
    """Return the physics of a machine whose modes were made with `held`."""
    laws = [(joint.law, joint.conductivity.size) for joint in joints]
    return Physics(modes, laws, held, ContactProblem(modes.elastic, laws))


@lru_cache(maxsize=64)
def heat_step(modes: Modes, length: float) -> HeatStep:
    """Return the step of some length (s); kept, as samples usually come evenly."""
    decay = 1.0 / (1.0 + length * modes.rates)
    drive, influence = (
        np.ascontiguousarray(length * decay[:, None] * influence)
        for influence in (modes.drive, modes.jump.T)
    )
    return HeatStep(decay, drive, influence, np.ascontiguousarray(modes.jump @ influence))


def conduct(
    physics: Physics, amplitudes: Array, inputs: Array, pressure: Array, length: float
) -> Array:
    """Return the amplitudes (r,) after `length` (s) at the joint's conductance of before.

    Parameters
    ----------
    physics : Physics
        The machine.
    amplitudes : ndarray, shape (r,)
        Before.
    inputs : ndarray, shape (s + 1,)
        Heat of each source, W, and the ambient, K.
    pressure : ndarray, shape (m,)
        Of the last step, Pa.
    length : float
        s.
    """
    step = heat_step(physics.modes, length)
    kernel = physics.kernel
    if kernel is not None:
        after = np.array(amplitudes)
        conduct_step(step, kernel, heat_work(kernel), after, inputs, pressure)
        return after
    alone = step.decay * amplitudes + step.drive @ inputs
    if not physics.contacts:
        return alone
    joint = physics.beyond_preload(pressure)
    system = joint[:, None] * step.joint_influence
    system.flat[:: len(joint) + 1] += 1.0
    flow = np.linalg.solve(system, joint * (physics.modes.jump @ alone))
    return np.asarray(alone - step.influence @ flow)


def settle_joint(
    physics: Physics, joint: JointState, amplitudes: Array
) -> tuple[JointState, Array]:
    """Return the joint in equilibrium with the temperatures, and the displacement (axes,), m.

    Raises
    ------
    ConvergenceError
        The gap equations have no solution that Newton's method finds.
    """
    kernel = physics.kernel
    if kernel is not None:
        after = JointState(*map(np.array, joint))
        displacement = np.empty(len(physics.modes.elastic.probe_thermal))
        if settle_step(kernel, joint_work(kernel), amplitudes, after, displacement) == 0:
            return after, displacement
    return settle_plainly(physics, joint, amplitudes)


def settle_plainly(
    physics: Physics, joint: JointState, amplitudes: Array
) -> tuple[JointState, Array]:
    """As `settle_joint`, without machine code of its own, and where the joint snaps."""
    elastic = physics.modes.elastic
    free = elastic.probe_thermal @ amplitudes
    if not physics.contacts:
        return joint, free
    thermal_gap = elastic.thermal_gap @ amplitudes
    settled, _ = settle_along(physics.contact, joint, thermal_gap)
    value = settled.traction.value
    remainder = value.ravel() + elastic.reference * settled.gap.ravel()
    after = JointState(
        settled.gap,
        settled.traction.slip,
        physics.preload + value[0],
        settled.gap - joint.gap,
    )
    return after, free + elastic.probe_compliance @ (elastic.area * remainder)


def simulate_known(physics: Physics, inputs: Array, length: float) -> tuple[Array, Array]:
    """March from rest under known inputs.

    Parameters
    ----------
    physics : Physics
        The machine.
    inputs : ndarray, shape (n, s + 1)
        Heat of each source, W, and the ambient, K, at the end of each step.
    length : float
        Of a step, s.

    Returns
    -------
    tuple of ndarray, shapes (n, p) and (n, axes)
        Sensors, K, and displacement, m.
    """
    inputs = np.ascontiguousarray(inputs, dtype=np.float64)
    amplitudes, joint = np.zeros(physics.modes.rates.size), physics.at_rest()
    history = np.empty((len(inputs), amplitudes.size))
    displacement = np.empty((len(inputs), len(physics.modes.elastic.probe_thermal)))
    step, kernel, k = heat_step(physics.modes, length), physics.kernel, 0
    if not physics.contacts:
        for at, driven in enumerate(inputs @ step.drive.T):
            amplitudes = step.decay * amplitudes + driven
            history[at] = amplitudes
        modes = physics.modes
        return history @ modes.sensors.T, history @ modes.elastic.probe_thermal.T
    if kernel is not None:
        machine = MarchKernel(step, kernel, UNWATCHED)
        kept = new_kept(machine, one_block(kernel.springs, kernel.compliance, kernel.columns))
    while k < len(inputs):
        if kernel is not None:
            now = Moving(amplitudes, joint)
            record = new_record(len(inputs) - k, now, displacement.shape[1])
            taken, _ = march_steps(machine, kept, inputs[k:], now, record)
            history[k : k + taken] = record.amplitudes[:taken]
            displacement[k : k + taken] = record.displacement[:taken]
            k += taken
            if k == len(inputs):
                break
        # Without machine code, or where the joint snaps.
        amplitudes = conduct(physics, amplitudes, inputs[k], joint.pressure, length)
        joint, displacement[k] = settle_plainly(physics, joint, amplitudes)
        history[k] = amplitudes
        k += 1
    return history @ physics.modes.sensors.T, displacement
