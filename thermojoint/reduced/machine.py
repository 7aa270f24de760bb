"""Mesh-free machine: all operators of the simulator on the modes of its reduced model.

Conduction, convection and the heat inputs stay apart, so that other values of the machine's
parameters cost a small eigenvalue problem and no finite element (`parameters`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fesim.case.joint_sections import JointSection
from fesim.case.schema import Case
from fesim.joint.law import JointLaw
from fesim.setup.laws import joint_conductivity, law_of
from fesim.setup.loads import heat_sources, source_power
from fesim.setup.machine import Setup
from fesim.setup.structure import body_materials
from fesim.solid.condensation import ElasticCondensation
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.heat import ThermalLoads, heat_operators
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.films import Film, films_of


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint as data.

    Attributes
    ----------
    section : JointSection
        As the case has it.
    conductivity : ndarray, shape (m,)
        k_h of Eq. 11 at its contact elements, W/(m K).
    """

    section: JointSection
    conductivity: Array

    @property
    def law(self) -> JointLaw:
        """Its text."""
        return law_of(self.section, self.conductivity)


@dataclass(frozen=True, eq=False)
class ReducedMachine:
    """M da/dt + (K + H) a = P u + h T_amb - B^T j on r modes, and what the joint needs.

    Attributes
    ----------
    capacity, conduction, convection : ndarray, shape (r, r)
        V^T M V (J/K for modes in K), V^T K V and V^T H V (W/K).
    sources : ndarray, shape (r, s)
        V^T P, per W of each source.
    ambient : ndarray, shape (r,)
        V^T h, W/K.
    jump : ndarray, shape (m, r)
        Temperature jump at every contact element, K.
    sensors : ndarray, shape (p, r)
        Temperature at every sensor, K.
    elastic : ElasticCondensation
        Gaps and displacement on the modes.
    joints : tuple of Joint
        In the order of the contact elements.
    sensor_names, axes, source_names : tuple of str
        What rows and columns belong to.
    power : ndarray, shape (s,)
        Heat of each source at heat input 1, W.
    step : float
        Longest time step, s.
    films : tuple of Film
        Convection of single surfaces: what of `convection` and `ambient` is theirs, or could be.
    """

    capacity: Array
    conduction: Array
    convection: Array
    sources: Array
    ambient: Array
    jump: Array
    sensors: Array
    elastic: ElasticCondensation
    joints: tuple[Joint, ...]
    sensor_names: tuple[str, ...]
    axes: tuple[str, ...]
    source_names: tuple[str, ...]
    power: Array
    step: float
    films: tuple[Film, ...] = ()

    @property
    def laws(self) -> list[tuple[JointLaw, int]]:
        """The law of each joint and its number of contact elements."""
        return [(joint.law, joint.conductivity.size) for joint in self.joints]

    @cached_property
    def at_preload(self) -> Array:
        """Conductance times area of every contact element at its preload, W/K."""
        parts = [law.conductance(np.full(count, law.preload)) for law, count in self.laws]
        return np.concatenate([np.empty(0), *parts]) * self.elastic.area[: len(self.jump)]


def check_joints(case: Case) -> None:
    """Raise InputError if a joint of the case is none that the estimator marches."""
    if case.loads:
        raise InputError("joint-aware: knows no mechanical loads; leave [loads] out")
    if case.bolts:
        raise InputError("joint-aware: knows no bolts; leave [bolts] out, and give a preload_MPa")
    if case.initial_temperature:
        raise InputError("joint-aware: starts at the ambient; leave [initial_temperature] out")
    if case.walls:
        raise InputError("joint-aware: knows no rigid walls; model [walls] as bodies, or leave out")
    for name, joint in case.joints.items():
        what = {
            "a joint without preload": joint.preload_MPa == 0.0,
            "a conducting gap": joint.gap is not None,
            f'conductance.law = "{joint.conductance.law}"': joint.conductance.law
            in ("fixed", "table", "none"),
        }
        for section, present in what.items():
            if present:
                raise InputError(
                    f"joint-aware: joints.{name} has {section}, which the estimator does not know; "
                    "estimate this machine by another method"
                )


def reduce_machine(case: Case, setup: Setup, sensors: Sequence[str]) -> ReducedMachine:
    """Return the machine of a case on the modes that its set-up has found.

    Parameters
    ----------
    case : Case
        With the reduced thermal model and without held temperatures.
    setup : Setup
        Of this case.
    sensors : sequence of str
        Temperature probes that will be read, in the order of the channels.

    Raises
    ------
    InputError
        The case has no source, or what a joint-aware estimator cannot have.
    """
    if case.held_temperatures:
        raise InputError(
            "joint-aware: held temperatures are not in its state; model them as sources"
        )
    check_joints(case)
    if not case.sources:
        raise InputError("joint-aware: the case has no source whose heat could be estimated")
    if setup.modes is None:
        raise InputError('joint-aware: needs the reduced model; set march.thermal = "reduced"')
    materials = body_materials(case, setup.structure)
    heat = heat_operators(
        setup.structure,
        setup.spaces.heat,
        materials,
        ThermalLoads(case.convection_W_m2K, heat_sources(case, setup.structure)),
        setup.joints,
    )
    basis = setup.modes.basis
    rows = [list(setup.probes).index(name) for name in sensors]
    count = len(case.sources)
    driven = basis.T @ heat.inputs
    return ReducedMachine(
        capacity=np.eye(basis.shape[1]),
        conduction=basis.T @ (heat.conduction @ basis),
        convection=basis.T @ (heat.convection @ basis),
        sources=driven[:, :count],
        ambient=driven[:, count],
        jump=np.asarray(setup.machine.thermal.jump),
        sensors=np.asarray(setup.probe_rows)[rows],
        elastic=setup.machine.contact.elastic,
        joints=tuple(
            Joint(case.joints[joint.name], joint_conductivity(setup.structure, materials, joint))
            for joint in setup.joints
        ),
        sensor_names=tuple(sensors),
        axes=DIRECTIONS,
        source_names=tuple(case.sources),
        power=np.array([source_power(source) for source in case.sources.values()]),
        step=case.march.step_s,
        films=films_of(case, setup),
    )


def along(machine: ReducedMachine, axes: Sequence[str]) -> ReducedMachine:
    """Return the machine with the displacement along some of its axes only."""
    rows = [machine.axes.index(axis) for axis in axes]
    elastic = machine.elastic
    kept = replace(
        elastic,
        probe_compliance=elastic.probe_compliance[rows],
        probe_thermal=elastic.probe_thermal[rows],
    )
    return replace(machine, elastic=kept, axes=tuple(axes))


@dataclass(frozen=True, eq=False)
class Modes:
    """A reduced machine whose heat equation is diagonal: da/dt + rates a = drive u - B^T j.

    Attributes
    ----------
    rates : ndarray, shape (r,)
        1/s.
    drive : ndarray, shape (r, s + 1)
        Per W of each source, then per K of the ambient.
    jump : ndarray, shape (m, r)
        As in `ReducedMachine`.
    sensors : ndarray, shape (p, r)
        As in `ReducedMachine`.
    elastic : ElasticCondensation
        On these modes.
    film : ndarray, shape (r, r)
        The part of the rates, a full matrix, that is convection, 1/s.
    """

    rates: Array
    drive: Array
    jump: Array
    sensors: Array
    elastic: ElasticCondensation
    film: Array


def diagonal_modes(machine: ReducedMachine, held: Array | None = None) -> Modes:
    """Turn the modes so that the heat equation is diagonal.

    Parameters
    ----------
    machine : ReducedMachine
        Any.
    held : ndarray, shape (m,), optional
        Conductance times area, W/K, with which the joint belongs to the linear part: then the
        joint heat flows are those beyond it. Default: none.
    """
    return on_basis(machine, *diagonal_basis(machine, held))


def diagonal_basis(machine: ReducedMachine, held: Array | None = None) -> tuple[Array, Array]:
    """Return the rates (r,), 1/s, and the basis (r, r) that `diagonal_modes` turns to."""
    conduction = machine.conduction + machine.convection
    if held is not None:
        conduction = conduction + machine.jump.T @ (held[:, None] * machine.jump)
    # M = L L^T: a symmetric problem of the usual kind.
    root = np.linalg.inv(np.linalg.cholesky(machine.capacity))
    system = root @ conduction @ root.T
    rates, turn = np.linalg.eigh(0.5 * (system + system.T))
    return np.maximum(rates, 0.0), root.T @ turn


def on_basis(machine: ReducedMachine, rates: Array, basis: Array) -> Modes:
    """Return a machine's modes on a basis (r, r) that makes its heat equation diagonal."""
    elastic = machine.elastic
    return Modes(
        rates=rates,
        drive=basis.T @ np.column_stack([machine.sources, machine.ambient]),
        jump=machine.jump @ basis,
        sensors=machine.sensors @ basis,
        elastic=replace(
            elastic,
            thermal_gap=elastic.thermal_gap @ basis,
            probe_thermal=elastic.probe_thermal @ basis,
        ),
        film=basis.T @ machine.convection @ basis,
    )
