"""What a march goes on from, and what a step of it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from artefacts.arrays import Array


@dataclass(frozen=True)
class State:
    """Everything the next step depends on.

    Attributes
    ----------
    index : int
        Steps taken; time is index times the step length.
    temperature : ndarray, shape (n,)
        Nodal temperatures above the initial ambient, K, or a reduced model's amplitudes.
    gap : ndarray, shape (3, m)
        Gaps, m.
    slip : ndarray, shape (2, m)
        Irreversible slip, m: the history of friction.
    pressure : ndarray, shape (m,)
        Contact pressure, Pa.
    change : ndarray, shape (3, m)
        By how much the last step changed the gaps, m: the next step's first guess goes on so.
    model : str
        Whose temperature it is: the `model` of the `ThermalCondensation`.
    anchor : ndarray, shape (7, m)
        Where the inverses were made that machine code keeps from step to step: six entries of the
        joint law's tangent (Pa/m), conductance times area (W/K); zero where there are none.
    """

    index: int
    temperature: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    model: str
    anchor: Array


class JointState(Protocol):
    """What the gap equations go on from; attributes as in `State`."""

    @property
    def gap(self) -> Array:
        """Gaps."""
        ...

    @property
    def slip(self) -> Array:
        """History of friction."""
        ...

    @property
    def change(self) -> Array:
        """By how much the last step changed the gaps."""
        ...


@dataclass(frozen=True)
class Step:
    """One step of the march and the evidence that it is right.

    Attributes
    ----------
    state : State
        At the end of the step.
    inputs : ndarray, shape (k + l,)
        What drove the step: sources, W; ambient and held surfaces, K; factors of the loads.
    conductance, heat_flow : ndarray, shape (m,)
        W/(m2 K), and W from side a to side b.
    displacement : ndarray, shape (k,)
        Displacement probes, m.
    remainder : ndarray, shape (3 m,)
        z + k g, Pa: with the temperature, it gives the displacement field.
    residual : float
        Largest residual of the gap equations, m.
    iterations, cuts : int
        Newton iterations, and viscous steps where a joint snapped.
    heat_balance : float
        (in - stored - convected) / the largest of the three.
    """

    state: State
    inputs: Array
    conductance: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: float
    iterations: int
    cuts: int
    heat_balance: float
