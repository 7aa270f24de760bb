"""The condensed simulator against a full assembly, and its order in the time step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
from scipy.sparse import csr_array, eye_array, kron

from fesim.joint.law import Friction, JointLaw
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.reduced import (
    DISPLACEMENT_ERROR,
    GAP_ERROR,
    TEMPERATURE_ERROR,
    USUAL_POWER,
    ThermalModes,
    outputs_of,
    project_elasticity,
    project_heat,
    thermal_modes,
)
from fesim.march.stepping import Advance, Inputs, iterated, march, staggered
from fesim.setup.elastic import reference_springs
from fesim.solid.condensation import DisplacementField, condense_elasticity, condense_heat
from fesim.solid.elasticity import ElasticOperators, elastic_operators
from fesim.solid.heat import HeatOperators, HeatSource, ThermalLoads, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces, probe_rows
from meshes.milling_machine import MillingMachineDimensions, box_milling_machine
from meshes.pairing import PairedJoint, pair_joint
from meshes.structure import Probe, Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.manufactured import order_of
from thermojoint.verification.plain_march import PlainStep, plain_march
from thermojoint.verification.series import law_at
from thermojoint.verification.structures import IRON, LEFT, SECTION, STEEL, bars

#: Largest gap residual, m: far below the march's, so that only the methods are compared.
RESIDUAL = 1e-17
TOLERANCE = 1e-9

#: Number of coupled steps; heat (W) against step number; rise of the ambient per step, K.
COUNT = 5
HISTORY = np.array([[0.0, 3.0, 4.0], [0.0, 2000.0, -4000.0]])
WARMING = 0.2

#: Tolerances of the reduced model at this heat: K and m; pressure relative to the largest.
_HEAT = np.abs(HISTORY[1]).max() / USUAL_POWER
ALLOWED = {
    "temperature": _HEAT * TEMPERATURE_ERROR,
    "displacement": _HEAT * DISPLACEMENT_ERROR,
    "probed displacement": _HEAT * DISPLACEMENT_ERROR,
    "gap": _HEAT * GAP_ERROR,
    "slip": _HEAT * GAP_ERROR,
}
ALLOWED_PRESSURE = 1e-3

#: Step lengths, s, and the time at which marches of different step length are compared, s.
STEPS, TIME = (2.0, 1.0, 0.5), 48.0


@dataclass(frozen=True)
class Assembled:
    """The assembled operators of a structure, and the machine condensed from them."""

    #: Operators of the whole structure.
    heat: HeatOperators
    elastic: ElasticOperators
    joints: JointOperators
    #: Shape (k, n): rows of the displacement probes.
    probes: csr_array
    #: Shape (1, n): row of a temperature probe.
    thermometer: csr_array
    #: The machine to be simulated.
    machine: CondensedMachine
    #: Computes displacements from its results.
    field: DisplacementField


@dataclass(frozen=True)
class Model:
    """A structure with one joint, before the assembly."""

    #: Arguments of `fesim.solid.heat.heat_operators`.
    structure: Structure
    joint: PairedJoint
    materials: dict[str, Material]
    loads: ThermalLoads
    #: Arguments of `fesim.solid.elasticity.elastic_operators`.
    fixed: list[str]
    rollers: dict[str, str]
    #: Probes of displacement and temperature.
    probe: Probe


def assemble(model: Model, law: JointLaw, step: float) -> Assembled:
    """Assemble a structure with one joint, and condense it for steps of some length, s."""
    structure, materials, probe = model.structure, model.materials, {"probe": model.probe}
    spaces = make_spaces(structure.mesh)
    joints = joint_operators([model.joint], spaces)
    heat = heat_operators(structure, spaces.heat, materials, model.loads)
    elastic = elastic_operators(structure, spaces, materials, model.fixed, model.rollers)
    probes = csr_array(kron(probe_rows(spaces.elastic, structure, probe), eye_array(3)))
    thermometer = probe_rows(spaces.heat, structure, probe)
    springs = reference_springs(structure, materials, [model.joint])
    condensed, field = condense_elasticity(elastic, joints, springs, probes)
    laws = [(law, len(joints.area))]
    thermal = condense_heat(heat, joints, step)
    machine = CondensedMachine(thermal, ContactProblem(condensed, laws, RESIDUAL))
    return Assembled(heat, elastic, joints, probes, thermometer, machine, field)


def heated_bars(kind: str, law: JointLaw, step: float) -> Assembled:
    """Return bars of iron and steel between walls, with non-matching meshes; input 1 is 1 W.

    Heat on one side and air on the other rotate the joint; different expansions make it slide.
    """
    structure = bars(kind, (2, 3, 1), (2, 2, 2))
    model = Model(
        structure,
        pair_joint(structure, "joint", 3, 2),
        {"left": IRON, "right": STEEL},
        ThermalLoads({"y0": 50.0}, [HeatSource(1.0, surface="y1")]),
        ["x0", "x1"],
        {"z0": "z"},
        Probe((LEFT, *SECTION), "left"),
    )
    return assemble(model, law, step)


def coarse_machine(law: JointLaw, step: float) -> Assembled:
    """Return half of the reference milling machine on elements of 100 mm; input 1 is 1 W."""
    structure = box_milling_machine(MillingMachineDimensions(), element_size=0.1)
    materials = {"column": IRON, "table": IRON}
    materials["screw"] = replace(IRON, youngs_modulus=2940e9)
    heating = HeatSource(1.0 / structure.symmetry_factor, surface="bearings")
    model = Model(
        structure,
        pair_joint(structure, "knee", 9, 3),
        materials,
        ThermalLoads({"exterior": 6.0}, [heating]),
        ["column_base", "screw_foot"],
        {"symmetry": "z"},
        structure.probes["A"],
    )
    return assemble(model, law, step)


def condensed_checks() -> Iterator[Check]:
    """Compare condensed and plain march, then the reduced march of the largest structure."""
    law = replace(law_at(4.41e6), friction=Friction(0.1, 1e12))
    for kind in ("hexahedra", "tetrahedra"):
        made = heated_bars(kind, law, 4.0)
        yield from compared(f"condensed march, bars, {kind}", made, plain_steps(made))
    made = coarse_machine(law, 120.0)
    plain = plain_steps(made)
    yield from compared("condensed march, milling machine", made, plain)
    modes = modes_of(made)
    reduced = replace(made, machine=reduced_machine(made, modes))
    yield from compared("reduced march, milling machine", reduced, plain, modes)


def plain_steps(made: Assembled) -> list[PlainStep]:
    """March without condensation."""
    marching = plain_march(made.heat, made.elastic, made.joints, made.machine, driven(made))
    return list(islice(marching, COUNT))


def modes_of(made: Assembled) -> ThermalModes:
    """Return the modes used by a case of this structure."""
    machine = made.machine
    step = machine.thermal.step
    outputs = outputs_of(machine.contact.elastic, made.thermometer)
    return thermal_modes(made.heat, made.joints, outputs, step)


def reduced_machine(made: Assembled, modes: ThermalModes) -> CondensedMachine:
    """Return the machine on its modes."""
    machine = made.machine
    thermal = project_heat(made.heat, made.joints, machine.thermal.step, modes)
    elastic = project_elasticity(machine.contact.elastic, modes)
    return replace(machine, thermal=thermal, contact=replace(machine.contact, elastic=elastic))


def driven(made: Assembled) -> Inputs:
    """Return heat and ambient as functions of time, s."""

    def inputs(time: float) -> Array:
        steps = time / made.machine.thermal.step
        return np.array([np.interp(steps, *HISTORY), WARMING * steps])

    return inputs


def compared(
    name: str, made: Assembled, plain: Sequence[PlainStep], modes: ThermalModes | None = None
) -> Iterator[Check]:
    """Check each quantity at its worst step and place, relative to its largest value in the run."""
    series_of: dict[tuple[str, str], list[tuple[Array, Array]]] = {}
    for theirs, step in zip(plain, march(made.machine, driven(made), staggered), strict=False):
        state = step.state
        temperature = state.temperature if modes is None else modes.basis @ state.temperature
        for key, ours, reference in (
            (("temperature", "K"), temperature, theirs.temperature),
            (
                ("displacement", "m"),
                made.field.solve(temperature, step.remainder),
                theirs.displacement,
            ),
            (("probed displacement", "m"), step.displacement, made.probes @ theirs.displacement),
            (("pressure", "Pa"), state.pressure, theirs.pressure),
            (("gap", "m"), state.gap.ravel(), made.joints.gap @ theirs.displacement),
            (("slip", "m"), state.slip.ravel(), theirs.slip.ravel()),
        ):
            series_of.setdefault(key, []).append((reference, ours))
    for (quantity, unit), pairs in series_of.items():
        reference, ours = (np.array(side) for side in zip(*pairs, strict=True))
        at = np.unravel_index(int(np.argmax(np.abs(ours - reference))), ours.shape)
        scale = float(np.abs(reference).max())
        allowed = ALLOWED.get(quantity, ALLOWED_PRESSURE * scale) / scale
        tolerance = TOLERANCE if modes is None else allowed
        compared_quantity = Quantity(quantity, unit, tolerance, "plain assembly")
        yield compared_quantity.check(name, reference[at], ours[at], scale)


def splitting_checks() -> Iterator[Check]:
    """Orders in the time step, between the two finest of three."""
    law = replace(law_at(0.2e6), friction=Friction(0.3, 1e12))
    made = heated_bars("hexahedra", law, STEPS[0])
    ends = {
        advance: [end_of(made, step, advance) for step in STEPS]
        for advance in (staggered, iterated)
    }
    for quantity, at in (("temperature", 0), ("pressure", 1)):
        loose, tight = ([end[at] for end in ends[advance]] for advance in (staggered, iterated))
        apart = [np.abs(coarse - fine).max() for coarse, fine in zip(loose, tight, strict=True)]
        name = f"order of the {quantity}"
        yield order("splitting, staggered less iterated", name, apart)
        for how, series in (("staggered", loose), ("iterated", tight)):
            steps = [np.abs(coarse - fine).max() for coarse, fine in pairwise(series)]
            yield order(f"splitting, {how} march in dt", name, steps)


def end_of(made: Assembled, step: float, advance: Advance) -> tuple[Array, Array]:
    """Temperature and pressure at `TIME` by steps of a length, s."""
    machine = replace(made.machine, thermal=condense_heat(made.heat, made.joints, step))
    inputs = np.array([600.0, 0.0])
    steps = march(machine, lambda _: inputs, advance)
    state = next(islice(steps, round(TIME / step) - 1, None)).state
    return state.temperature, state.pressure


def order(name: str, quantity: str, errors: list[float]) -> Check:
    """Check an order of one by the last two errors, each for half the previous step."""
    return order_of(quantity).check(name, 1.0, np.log2(errors[-2] / errors[-1]))
