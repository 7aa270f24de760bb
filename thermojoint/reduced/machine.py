"""Mesh-free machine: all operators of the simulator on the modes of its reduced model.

Conduction, convection and the heat inputs stay apart, so that other values of the machine's
parameters cost a small eigenvalue problem and no finite element (`parameters`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from fesim.axes.condensation import TiedCondensations
from fesim.axes.guideway import Guideway, Place
from fesim.case.joint_sections import JointSection
from fesim.case.schema import Case
from fesim.joint.conductance import ConductanceTable
from fesim.joint.law import JointLaw
from fesim.march.assembly import tightened_contact
from fesim.march.contact import ContactProblem, Laws
from fesim.march.machine import CondensedMachine
from fesim.march.passing import exchange
from fesim.march.settling import Rest, first_equilibrium
from fesim.setup.bolts import first_forces
from fesim.setup.faces import with_faces
from fesim.setup.laws import as_walled, initial_opening, joint_conductivity, law_of, table_of
from fesim.setup.loads import heat_sources, march_inputs, source_power
from fesim.setup.machine import Setup
from fesim.setup.structure import body_materials, displacement_of
from fesim.solid.bolts import BoltSprings
from fesim.solid.condensation import ElasticCondensation, LoadInfluence
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.heat import HeatSource, ThermalLoads, heat_operators
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.axis_drive import AxisDrives
from thermojoint.reduced.films import Film, films_of
from thermojoint.reduced.supports import Supports

#: Rate at which the amplitude of a held surface follows its temperature, 1/s: at once, in any step.
FOLLOWS = 1e12
#: A mode is isolated if its rate and its drive are less than this part of the largest.
ALONE = 1e-9
#: Least relative difference of the rates of a mode and of a sensor's lag.
NEAR = 1e-4


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint as data."""

    #: As in the case.
    section: JointSection
    #: Shape (m,): k_h of Eq. 11 at its contact elements, W/(m K).
    conductivity: Array
    #: Shape (m,): at the start, m, of a joint without preload.
    opening: Array | None = None
    #: Of a joint whose conductance is measured.
    table: ConductanceTable | None = None

    @property
    def conducts(self) -> bool:
        """Whether any heat passes."""
        return self.section.conductance.law != "none" or self.section.gap is not None

    @property
    def law(self) -> JointLaw:
        """Its law."""
        return law_of(self.section, self.conductivity, self.opening, self.table)


@dataclass(frozen=True, eq=False)
class Acting:
    """What acts on a machine besides heat: l mechanical loads and b bolts."""

    #: Of the loads at factor one, then of each bolt per N; its last b probes are the bolts' ends.
    influence: LoadInfluence
    #: Shape (l + b,): of the loads at time zero, and the forces of the bolts after tightening, N.
    factors: Array
    #: Of the bolts, on the modes.
    springs: BoltSprings
    #: Loads whose factors are inputs: the first ones. The others are constant.
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Held:
    """Surfaces whose temperature is held; their amplitudes come after those of the modes."""

    #: Of the h surfaces.
    names: tuple[str, ...] = ()
    #: Shape (h,): temperatures at time zero, K.
    first: Array = field(default_factory=lambda: np.zeros(0))
    #: Shape (h,): whether they change with time.
    varies: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass(frozen=True, eq=False)
class MovingAxis:
    """A moving axis: positions at which displacements are asked for, reference of its control."""

    #: Of the axis.
    name: str
    #: The axis of the displacement that it moves along, "" if it is oblique.
    along: str
    #: Shape (k,): positions, m.
    asked: Array
    #: P0 of the line through them, m.
    reference: float
    #: Whether its travel, to and fro, is counted.
    odometer: bool = False


@dataclass(frozen=True, eq=False)
class Guide:
    """Additional data of a machine with moving axes."""

    #: In the case's order.
    axes: tuple[MovingAxis, ...]
    #: On the machine's modes; without a drive the bodies stand where the control assumes.
    drives: AxisDrives
    #: On the same modes.
    way: Guideway
    #: Positions at time zero, m.
    first: Place

    def on(self, elastic: TiedCondensations) -> Guide:
        """Return the guide with other condensations at its aligned positions."""
        return replace(self, way=replace(self.way, elastic=elastic))

    def turned(self, rows: Callable[[Array], Array], columns: Callable[[Array], Array]) -> Guide:
        """Return the guide on other modes, by transforms of rows (..., r) and columns (r, ...)."""
        return replace(self, way=self.way.turned(rows), drives=self.drives.turned(rows, columns))


@dataclass(frozen=True, eq=False)
class ReducedMachine:
    """M da/dt + (K + H) a = P u + h T_amb - B^T j on r modes, and the data of the joint.

    The last of the modes are held surfaces at 1 K: their amplitudes are given.
    """

    #: Shape (r, r): V^T M V (J/K for modes in K), V^T K V and V^T H V (W/K).
    capacity: Array
    conduction: Array
    convection: Array
    #: Shape (r, s): V^T P, per W of each source.
    sources: Array
    #: Shape (r, p): likewise of the face that each sensor is on, heated evenly; zero for a sensor
    #: that is a held surface.
    faces: Array
    #: Shape (r, b): likewise of every body, heated evenly.
    bodies: Array
    #: Shape (r,): V^T h, W/K.
    ambient: Array
    #: Shape (m, r): temperature jump at every contact element, and the mean of its sides, K. On an
    #: axis, `jump` has the temperatures of the guideway's q rows, and `mean` holds at the first
    #: positions.
    jump: Array
    mean: Array
    #: Shape (p, r): temperature at every sensor, K.
    sensors: Array
    #: Shape (r,): amplitudes at time zero.
    start: Array
    #: Gaps and displacement on the modes; before the bolts are tightened, followed by their ends.
    #: On axes, at the first positions, followed by the seats of drives.
    elastic: ElasticCondensation
    #: In the order of the contact elements.
    joints: tuple[Joint, ...]
    #: Names of rows and columns.
    sensor_names: tuple[str, ...]
    axes: tuple[str, ...]
    source_names: tuple[str, ...]
    #: Shape (s,): heat of each source at heat input 1, W.
    power: Array
    #: Longest time step, s.
    step: float
    #: Source whose power a control reads to the share of that power which becomes its heat.
    power_shares: Mapping[str, float] = field(default_factory=dict)
    #: Convection of single surfaces: their parts of `convection` and `ambient`, or additions.
    films: tuple[Film, ...] = ()
    #: Fixed supports, where their give is a parameter; `elastic` has the usual one.
    supports: Supports | None = None
    #: Loads and bolts.
    acting: Acting | None = None
    #: Held surfaces.
    held: Held = field(default_factory=Held)
    #: Time constant of each sensor in its mounting, s; empty if none lags.
    lags: tuple[float, ...] = ()
    #: Of a machine with moving axes.
    guide: Guide | None = None
    #: Sensor that is a probe to its position, m.
    places: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    #: The displaced and the reference point.
    displacement_of: str = ""

    @property
    def free(self) -> int:
        """Number of modes whose amplitudes are not given."""
        return len(self.start) - len(self.held.names)

    def inputs(self, power: Array, course: Array | None = None) -> Array:
        """Return inputs (n, s + h + 1 + x) of steps at the ambient.

        Parameters
        ----------
        power : ndarray, shape (n, s)
            Of the sources, W.
        course : ndarray, shape (n, x), optional
            Positions of the axes, m. Default: loads and axes are as at time zero.
        """
        held, ambient = np.tile(self.held.first, (len(power), 1)), np.zeros((len(power), 1))
        return np.hstack([power, held, ambient, ambient[:, :0] if course is None else course])

    @property
    def load_names(self) -> tuple[str, ...]:
        """Loads whose factors are inputs."""
        return () if self.acting is None else self.acting.names

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Axes whose positions are inputs, after the loads."""
        return () if self.guide is None else tuple(axis.name for axis in self.guide.axes)

    @property
    def laws(self) -> list[tuple[JointLaw, int]]:
        """The law of each joint and its number of contact elements."""
        return [(joint.law, joint.conductivity.size) for joint in self.joints]

    @cached_property
    def at_preload(self) -> Array:
        """Conductance times area of every contact element before the first step, W/K."""
        modes = own_modes(self)
        if self.guide is not None:
            modes = placed(modes, self.guide.first)
        contact = contact_of(modes, self.laws)
        rise, jump = modes.mean @ modes.start, modes.jump @ modes.start
        return conducted(contact, rest_of(contact, modes), rise, jump)

    def strained(self, modulus: float, expansion: float) -> ReducedMachine:
        """Return the machine with factors on elastic modulus and thermal expansion."""
        guide, elastic = self.guide, self.elastic.strained(modulus, expansion)
        if guide is not None:
            guide = guide.on(guide.way.elastic.strained(modulus, expansion))
        return replace(self, elastic=elastic, guide=guide)

    def with_sensors(self, names: Sequence[str]) -> ReducedMachine:
        """Return the machine with some of its sensors, none of which lags."""
        at = [self.sensor_names.index(name) for name in names]
        return replace(
            self, sensors=self.sensors[at], faces=self.faces[:, at], sensor_names=tuple(names)
        )

    def with_probes(self, probes: Sequence[int]) -> ReducedMachine:
        """Return the machine with some displacement probes, by their indices."""
        guide = self.guide
        if guide is not None:
            guide = guide.on(guide.way.elastic.with_probes(probes))
        return replace(self, elastic=self.elastic.with_probes(probes), guide=guide)


def conducted(contact: ContactProblem, joint: Rest, rise: Array, jump: Array) -> Array:
    """Return conductance times area (m,), W/K, at temperatures and jumps (m,), K, of contacts."""
    each = contact.conducts(joint.pressure, joint.gap[0], rise, jump)
    return each * contact.elastic.area[: contact.count]


def _acting(case: Case, setup: Setup) -> Acting | None:
    """Loads and bolts of a case, before the bolts are tightened."""
    loose = setup.machine if setup.bolts is None else setup.bolts.loose
    influence, count = loose.contact.loads, len(case.loads)
    if influence is None:
        return None
    for name, bolt in case.bolts.items():
        if bolt.file is not None:
            raise InputError(
                f"joint-aware: bolts.{name}: its force changes with time; leave its file out"
            )
    varying = [load.file is not None for load in case.loads.values()]
    bolts = range(count, influence.gap.shape[1])
    order = [*np.argsort(~np.array(varying, dtype=bool), kind="stable"), *bolts]
    forces = march_inputs(case).forces[:count]
    first = np.array([history(np.zeros(1))[0] for history in forces])
    springs = BoltSprings(np.zeros(0), np.zeros((0, loose.thermal.jump.shape[1])))
    return Acting(
        LoadInfluence(influence.gap[:, order], influence.probes[:, order]),
        np.concatenate([first, first_forces(case)])[order],
        springs if setup.bolts is None else setup.bolts.springs,
        tuple(name for name, load in case.loads.items() if load.file is not None),
    )


def reduce_machine(
    case: Case, setup: Setup, sensors: Sequence[str], guide: Guide | None = None
) -> ReducedMachine:
    """Return the machine of a case on the modes that its set-up has found.

    Parameters
    ----------
    case : Case
        With the reduced thermal model.
    setup : Setup
        Of this case.
    sensors : sequence of str
        Temperature probes and held surfaces that will be read, in the order of the channels.
    guide : Guide, optional
        Of a case with axes, whose set-up stands at the first positions.

    Raises
    ------
    InputError
        The case has no source, or something that a joint-aware estimator does not support.
    """
    if case.displacement is None:
        raise InputError("joint-aware: the case records no displacement; add [displacement]")
    if rubbing := [name for name, joint in case.joints.items() if joint.slip_heating]:
        raise InputError(
            f"joint-aware: joints.{rubbing[0]}: it does not know the heat of friction; leave out "
            "slip_heating"
        )
    if not case.sources:
        raise InputError("joint-aware: the case has no source whose heat could be estimated")
    if setup.modes is None:
        raise InputError('joint-aware: needs the reduced model; set march.thermal = "reduced"')
    materials = body_materials(case, setup.structure)
    sides = [side for both in setup.structure.joints.values() for side in both]
    thermometers = {name: setup.probes[name] for name in sensors if name in setup.probes}
    structure, faces = with_faces(setup.structure, [*case.supports.symmetry, *sides], thermometers)
    heated, bodies = sorted(set(faces.values())), list(structure.bodies)
    evenly = [
        *(HeatSource(1.0, surface=name) for name in heated),
        *(HeatSource(1.0, body=name) for name in bodies),
    ]
    own = heat_sources(case, setup.structure)
    heat = heat_operators(
        structure,
        setup.spaces.heat,
        materials,
        ThermalLoads(case.convection_W_m2K, [*own, *evenly]),
        setup.joints,
    )
    basis = setup.modes.basis
    held = _held(case)
    surfaces = np.eye(basis.shape[1])[basis.shape[1] - len(held.names) :]
    rows = dict(zip(held.names, surfaces, strict=True))
    rows |= dict(zip(setup.probes, np.asarray(setup.probe_rows), strict=True))
    joints = tuple(_joint(case, setup, at) for at in range(len(setup.joints)))
    passes = [float(joint.conducts) for joint in joints]
    each = np.repeat(passes, [joint.conductivity.size for joint in joints])
    ready = setup.machine
    loose = ready if setup.bolts is None else setup.bolts.loose
    # Heat of drives is that of `guide`.
    driven, others = np.split(basis.T @ heat.inputs, [len(own)], axis=1)
    faced = np.zeros((basis.shape[1], len(sensors)))
    for name, face in faces.items():
        faced[:, sensors.index(name)] = others[:, heated.index(face)]
    return ReducedMachine(
        capacity=np.eye(basis.shape[1]),
        conduction=basis.T @ (heat.conduction @ basis),
        convection=basis.T @ (heat.convection @ basis),
        sources=driven[:, : len(case.sources)],
        faces=faced,
        bodies=others[:, len(heated) : len(evenly)],
        ambient=others[:, len(evenly)],
        jump=each[:, None] * np.asarray(ready.thermal.jump)
        if guide is None
        else guide.way.temperature,
        mean=np.asarray(ready.thermal.mean),
        sensors=np.array([rows[name] for name in sensors]).reshape(-1, basis.shape[1]),
        start=_start(case, ready),
        elastic=loose.contact.elastic if guide is None else guide.way.elastic_at(guide.first),
        joints=joints,
        sensor_names=tuple(sensors),
        axes=DIRECTIONS,
        source_names=tuple(case.sources),
        power=np.array([source_power(source) for source in case.sources.values()]),
        step=case.march.step_s,
        power_shares={
            name: source.power_share
            for name, source in case.sources.items()
            if source.power_share is not None
        },
        films=films_of(case, setup),
        acting=_acting(case, setup),
        held=held,
        guide=guide,
        places={name: tuple(map(float, probe.position)) for name, probe in thermometers.items()},
        displacement_of=displacement_of(case),
    )


def _start(case: Case, machine: CondensedMachine) -> Array:
    """Amplitudes at time zero, (r,); held surfaces are at the ambient until the first step."""
    if machine.start is None:
        return np.zeros(machine.thermal.inputs.shape[0])
    return machine.start.temperature(march_inputs(case).at(np.zeros(1))[0])


def _held(case: Case) -> Held:
    sections = case.held_temperatures.values()
    return Held(
        tuple(case.held_temperatures),
        np.array([history(np.zeros(1))[0] for history in march_inputs(case).held]),
        np.array([section.file is not None for section in sections], dtype=bool),
    )


def _joint(case: Case, setup: Setup, at: int) -> Joint:
    paired = setup.joints[at]
    section = as_walled(case, case.joints[paired.name])
    conductivity = joint_conductivity(setup.structure, setup.materials, paired)
    return Joint(section, conductivity, initial_opening(section, paired), table_of(section))


def along(machine: ReducedMachine, axes: Sequence[str]) -> ReducedMachine:
    """Return the machine with the displacement along some of its axes only."""
    acting = machine.acting
    ends = range(len(machine.axes), len(machine.elastic.probe_thermal))
    rows = [*(machine.axes.index(axis) for axis in axes), *ends]
    if acting is not None:
        probes = acting.influence.probes[rows]
        acting = replace(acting, influence=replace(acting.influence, probes=probes))
    turned = replace(machine.with_probes(rows), acting=acting, axes=tuple(axes))
    if (guide := turned.guide) is None:
        return turned
    kept = [machine.axes.index(axis) for axis in axes]
    return replace(turned, guide=replace(guide, drives=guide.drives.along(kept)))


@dataclass(frozen=True, eq=False)
class Modes:
    """A reduced machine whose heat equation is diagonal: da/dt + rates a = drive u - B^T j."""

    #: Shape (r,): 1/s.
    rates: Array
    #: Shape (r, s + h + 1): per W of each source, then per K of the held surfaces and the ambient.
    drive: Array
    #: As in `ReducedMachine`, and so are `mean`, `sensors` and `start`.
    jump: Array
    #: Shape (r, m): drain of the modes per W across each contact element: the jump's transpose,
    #: but for modes of sensors that lag (`lagging`). On an axis, per W that leaves each row.
    entry: Array
    mean: Array
    sensors: Array
    start: Array
    #: On these modes; bolts are part of it.
    elastic: ElasticCondensation
    #: Shape (r, r): the part of the rates due to convection, a full matrix, 1/s; only
    #: `diagonal_modes` has it.
    film: Array
    #: Of l factors on gaps and displacement: loads, forces of the bolts, and the bolts' reference
    #: (`fesim.solid.bolts.fastened`).
    loads: LoadInfluence
    #: Shape (l,): at time zero; of a machine on axes their positions, m, are the last.
    factors: Array
    #: Shape (6, m): gap (m), slip (m) and pressure (Pa) of the joints after the bolts have been
    #: tightened; zero without bolts.
    tight: Array
    #: Of a machine with moving axes, and so are `drives`.
    way: Guideway | None = None
    drives: AxisDrives | None = None

    def with_more(
        self, rates: Array, rows: Callable[[Array], Array], columns: Callable[[Array], Array]
    ) -> Modes:
        """Return the modes with others of some rates, 1/s, that begin at zero.

        `rows` (..., r) and `columns` (r, ...) transform what is per mode.
        """
        return replace(
            self,
            rates=np.append(self.rates, rates),
            drive=columns(self.drive),
            jump=rows(self.jump),
            entry=columns(self.entry),
            mean=rows(self.mean),
            sensors=rows(self.sensors),
            start=np.append(self.start, np.zeros(rates.size)),
            elastic=self.elastic.turned(rows),
            way=None if self.way is None else self.way.turned(rows),
            drives=None if self.drives is None else self.drives.turned(rows, columns),
        )


def placed(modes: Modes, at: Place) -> Modes:
    """Return the modes of a machine whose axes are fixed at positions, m."""
    way = modes.way
    if way is None:
        return modes
    coefficients = way.stations.passage(at, at).coefficients
    jump, mean = way.sides(coefficients)
    return replace(
        modes,
        jump=jump,
        entry=modes.entry @ coefficients.T,
        mean=mean,
        elastic=way.elastic_at(at),
        way=None,
    )


def contact_of(modes: Modes, laws: Laws) -> ContactProblem:
    """Return the joints of a machine."""
    return ContactProblem(modes.elastic, laws, loads=modes.loads if modes.factors.size else None)


def rest_of(contact: ContactProblem, modes: Modes) -> Rest:
    """Return the joints before the first step: tightened, at the first temperatures, under loads.

    Raises
    ------
    ConvergenceError
        There is no equilibrium.
    """
    gap, slip, pressure = modes.tight[:3], modes.tight[3:5], modes.tight[5]
    tight = Rest(gap, slip, pressure, np.zeros_like(gap)) if modes.tight.any() else None
    opened = None
    if tight is not None or modes.factors.size or modes.start.any():
        opened = modes.elastic.thermal_gap @ modes.start + modes.loads.gap @ modes.factors
    return first_equilibrium(contact, tight, opened)


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
    rates, basis = diagonal_basis(machine, held)
    modes = on_basis(machine, rates, basis, held)
    film = basis.T @ machine.convection @ basis
    return replace(modes, film=np.pad(film, (0, modes.rates.size - rates.size)))


def diagonal_basis(machine: ReducedMachine, held: Array | None = None) -> tuple[Array, Array]:
    """Return the rates (k,), 1/s, and the basis (r, k) that `diagonal_modes` turns to."""
    whole, free = conducting(machine, held), machine.free
    system, capacity = whole[:free, :free], machine.capacity[:free, :free]
    # The modes of a case are orthonormal already.
    plain = np.array_equal(capacity, np.eye(free))
    rates, basis = np.linalg.eigh(system) if plain else eigh(system, capacity, check_finite=False)
    # A rigid wall without heat flow is an isolated mode, which nothing drives or reads.
    drives = [machine.sources, machine.ambient, machine.jump.T, whole[:, free:]]
    driven = np.abs(basis.T @ np.column_stack(drives)[:free])
    alone = (rates <= ALONE * rates.max()) & (driven.max(axis=1) <= ALONE * driven.max())
    kept, surfaces = np.maximum(rates[~alone], 0.0), len(machine.start) - free
    turned = np.zeros((free + surfaces, kept.size + surfaces))
    turned[:free, : kept.size], turned[free:, kept.size :] = basis[:, ~alone], np.eye(surfaces)
    return np.append(kept, np.full(surfaces, FOLLOWS)), turned


def conducting(machine: ReducedMachine, held: Array | None) -> Array:
    """Return K + H with the part of the joint that belongs to the modes, W/K, shape (r, r).

    `held` is as for `diagonal_modes`; axes are equally often at every position.
    """
    conduction = machine.conduction + machine.convection
    if held is None:
        return conduction
    if machine.guide is not None:
        return np.asarray(
            conduction + machine.jump.T @ evenly_exchanged(machine.guide.way, held) @ machine.jump
        )
    return np.asarray(conduction + machine.jump.T @ (held[:, None] * machine.jump))


def evenly_exchanged(way: Guideway, held: Array) -> Array:
    """Return L (q, q), W/K, of axes equally often at every position, at conductances (m,)."""
    return exchange(way.stations.everywhere.touches, held, way.stations.size)


def own_modes(machine: ReducedMachine) -> Modes:
    """Return a machine's modes as they are, for what does not depend on their rates."""
    size = len(machine.start)
    return on_basis(machine, np.zeros(size), np.eye(size))


def on_basis(
    machine: ReducedMachine, rates: Array, basis: Array, held: Array | None = None
) -> Modes:
    """Return a machine's modes on a basis (r, k) that makes its heat equation diagonal.

    Without `Modes.film`, which no march needs.

    Parameters
    ----------
    machine : ReducedMachine
        Any.
    rates, basis, held
        As from and for `diagonal_basis`.
    """
    turned = coupled_in(machine, basis)
    elastic, acting, guide = turned.elastic, turned.acting, turned.guide
    probes = len(machine.axes) if guide is None else len(elastic.probe_thermal)
    loads = LoadInfluence(np.zeros((len(elastic.reference), 0)), np.zeros((probes, 0)))
    factors, tight = np.zeros(0), np.zeros((6, elastic.area.size))
    if acting is not None:
        loads, factors = acting.influence, acting.factors
    if acting is not None and acting.springs.flexibility.size:
        forces = factors[-acting.springs.flexibility.size :]
        contact = ContactProblem(elastic, machine.laws, loads=loads)
        bolted, assembly, _ = tightened_contact(contact, acting.springs, forces)
        assert bolted.loads is not None  # tightened_contact makes them
        elastic, loads, factors = bolted.elastic, bolted.loads, np.append(factors, 1.0)
        tight = np.vstack([assembly.gap, assembly.slip, assembly.pressure])
    if guide is not None:
        # A position displaces nothing by itself.
        more = ((0, 0), (0, len(guide.first)))
        loads = LoadInfluence(np.pad(loads.gap, more), np.pad(loads.probes, more))
        factors = np.append(factors, guide.first)
    modes = Modes(
        rates=rates,
        drive=_drive(machine, turned, rates, basis, held),
        jump=turned.jump,
        entry=turned.jump.T,
        mean=turned.mean,
        sensors=turned.sensors,
        start=turned.start,
        elastic=elastic,
        film=np.zeros((0, 0)),
        loads=loads,
        factors=factors,
        tight=tight,
        way=None if guide is None else guide.way,
        drives=None if guide is None else guide.drives,
    )
    return lagging(modes, np.array(machine.lags)) if machine.lags else modes


def lagging(modes: Modes, lags: Array) -> Modes:
    """Return modes whose sensors follow the temperature at their places with first-order lags.

    A sensor's reading y follows the temperature C a there by lag dy/dt = C a - y. With c = C / (1 -
    lag rates), y - c a relaxes with the time constant lag and is driven by -c times what drives a:
    it is one more mode, and the equations stay diagonal, those of an implicit step included.

    Parameters
    ----------
    modes : Modes
        Of sensors that do not lag.
    lags : ndarray, shape (p,)
        Time constants, s; zero for a sensor that does not lag.
    """
    slow = np.flatnonzero(lags > 0.0)
    lag = lags[slow, None]
    # Where a rate equals that of a lag the solution has another form; a lag nearby is as good.
    while (near := np.abs(1.0 - lag * modes.rates).min(axis=1, initial=1.0) < NEAR).any():
        lag = lag * np.where(near, 1.0 + 2.0 * NEAR, 1.0)[:, None]
    seen = modes.sensors[slow]
    followed = seen / (1.0 - lag * modes.rates)

    def none(rows: Array) -> Array:
        return np.pad(rows, ((0, 0), (0, slow.size)))

    def driven(columns: Array) -> Array:
        return np.vstack([columns, -followed @ columns])

    sensors = none(modes.sensors)
    sensors[slow] = np.hstack([followed, np.eye(slow.size)])
    start = np.append(modes.start, (seen - followed) @ modes.start)
    found = modes.with_more(1.0 / lag[:, 0], none, driven)
    return replace(found, sensors=sensors, start=start)


def _drive(
    machine: ReducedMachine, turned: ReducedMachine, rates: Array, basis: Array, held: Array | None
) -> Array:
    """Drive by sources, held surfaces and ambient, (k, s + h + 1); held surfaces follow."""
    surfaces = len(machine.held.names)
    if not surfaces:
        return np.column_stack([turned.sources, turned.ambient])
    free = rates.size - surfaces
    drawn = -basis.T @ (conducting(machine, held)[:, machine.free :])
    drive = np.column_stack([turned.sources, drawn, turned.ambient])
    drive[free:] = 0.0
    drive[free:, machine.power.size : -1] = np.diag(rates[free:])
    return drive


def coupled_in(machine: ReducedMachine, basis: Array) -> ReducedMachine:
    """Return a machine on other modes, columns of `basis` (r, k), but for its r x r matrices."""
    acting, guide = machine.acting, machine.guide
    start: Array = np.zeros(basis.shape[1])
    if machine.start.any():
        capacity = basis.T @ machine.capacity
        start[:] = np.linalg.solve(capacity @ basis, capacity @ machine.start)
    if acting is not None:
        springs = replace(acting.springs, growth=acting.springs.growth @ basis)
        acting = replace(acting, springs=springs)

    def turned(rows: Array) -> Array:
        return np.asarray(rows @ basis)

    return replace(
        machine,
        sources=basis.T @ machine.sources,
        faces=basis.T @ machine.faces,
        bodies=basis.T @ machine.bodies,
        ambient=basis.T @ machine.ambient,
        jump=machine.jump @ basis,
        mean=machine.mean @ basis,
        sensors=machine.sensors @ basis,
        start=start,
        elastic=machine.elastic.turned(turned),
        guide=None if guide is None else guide.turned(turned, lambda columns: basis.T @ columns),
        acting=acting,
    )
