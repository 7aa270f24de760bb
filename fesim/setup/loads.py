"""Thermal and mechanical loads and springs of a case in SI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fesim.case.history import (
    Histories,
    History,
    common_knots,
    entering_in_steps,
    mean_over_steps,
    ramp_history,
    read_history,
    reversals,
    step_history,
    triangle_history,
)
from fesim.case.schema import Case, heated_by_drives, step_count
from fesim.case.thermal_sections import (
    HeatInput,
    HeldTemperatureSection,
    RampInput,
    SampledInput,
    SourceSection,
    StepInput,
    TriangleInput,
)
from fesim.setup.bolts import tightening
from fesim.setup.positions import profile_of
from fesim.solid.forces import BodyForce, Load, SurfaceForce, SurfacePressure
from fesim.solid.heat import HeatSource, InputLayout
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MEGA


def heat_sources(case: Case, structure: Structure) -> list[HeatSource]:
    """Return the sources of the meshed part, per W of the whole structure, in case order.

    Those of drives are last.
    """
    sources = []
    part = 1.0 / structure.symmetry_factor
    for name, section in case.sources.items():
        if section.surface is not None:
            structure.surface(section.surface, f"sources.{name}.surface")
        else:
            structure.body(section.body or "", f"sources.{name}.body")
        weight = None
        if section.profile is not None:
            weight = profile_of(section.profile, f"sources.{name}.profile", 0.0)
        sources.append(HeatSource(part, section.surface, section.body, weight))
    for name, surface in heated_by_drives(case).items():
        structure.surface(surface, f"axes: heat of {name}")
        sources.append(HeatSource(part, surface, None, None))
    return sources


def source_names(case: Case) -> list[str]:
    """Return the names of all sources, in the order of the inputs."""
    return [*case.sources, *heated_by_drives(case)]


def held_profiles(case: Case) -> dict[str, OfPosition | None]:
    """Return the position-dependent factor of every held surface; None if uniform."""
    return {
        name: None
        if held.profile is None
        else profile_of(held.profile, f"held_temperatures.{name}.profile")
        for name, held in case.held_temperatures.items()
    }


def mechanical_loads(case: Case, structure: Structure) -> list[Load]:
    """Return the forces, pressures and weights on the meshed part, in the order of the case.

    Raises
    ------
    InputError
        A load refers to a surface or a body that does not exist.
    """
    loads: list[Load] = []
    for name, load in case.loads.items():
        where = f"loads.{name}"
        if load.acceleration_m_s2 is not None:
            # A rigid wall has no volume and no weight.
            every = tuple(body for body in structure.bodies if body not in case.walls)
            bodies = every if load.bodies is None else tuple(load.bodies)
            for body in bodies:
                structure.body(body, f"{where}.bodies")
            loads.append(BodyForce(bodies, load.acceleration_m_s2))
            continue
        surface = load.surface or ""
        structure.surface(surface, f"{where}.surface")
        if load.force_N is not None:
            x, y, z = (component / structure.symmetry_factor for component in load.force_N)
            loads.append(SurfaceForce(surface, (x, y, z)))
        elif load.pressure_MPa is not None:
            loads.append(SurfacePressure(surface, MEGA * load.pressure_MPa))
    return loads


def spring_stiffnesses(case: Case, structure: Structure) -> dict[str, tuple[float, float, float]]:
    """Return the springs under each surface of the meshed part, N/m."""
    part = MEGA / structure.symmetry_factor
    return {
        name: (part * x, part * y, part * z)
        for name, section in case.supports.springs.items()
        for x, y, z in [section.stiffness_N_um]
    }


def source_power(source: SourceSection) -> float:
    """Heat of a source to the whole structure at heat input 1, W."""
    each = source.reference_power_W
    return each * source.count if source.reading == "per source" else each


def input_layout(case: Case) -> InputLayout:
    """Return the order of the inputs of a case's march."""
    return InputLayout(len(source_names(case)), len(case.held_temperatures))


@dataclass(frozen=True, eq=False)
class MarchInputs:
    """Histories of the inputs of a march: thermal ones, then those of loads and bolts."""

    #: Order of the thermal inputs.
    layout: InputLayout
    #: Length of a step, s.
    step: float
    #: The case's heat input.
    heat: History
    #: Power at heat input 1, W, and heat input of each source.
    sources: list[tuple[float, History]]
    #: Ambient temperature, °C.
    ambient: History | None
    #: Temperatures of the held surfaces, K.
    held: list[History]
    #: Factors of the loads, forces of the bolts (N), and 1 if there are bolts
    #: (`fesim.solid.bolts.fastened`).
    forces: list[History]

    def at(self, ends: Array) -> Array:
        """Return the inputs of the steps that end at `ends` (n,), s: a row for each.

        Heat and ambient by `entering_in_steps`, held temperatures by `mean_over_steps`, forces at
        the end of the step.
        """
        return self._rows(
            ends,
            lambda history: entering_in_steps(history, self.step, ends),
            lambda history: mean_over_steps(history, self.step, ends),
        )

    def exactly(self) -> Histories:
        """Return the inputs as functions of time, for a march whose steps end at the knots."""
        ambient = [] if self.ambient is None else [self.ambient]
        sources = [history for _, history in self.sources]
        times = common_knots([*sources, *ambient, *self.held, *self.forces])

        def values(history: History) -> Array:
            return history(times)

        return Histories(times, self._rows(times, values, values))

    def _rows(
        self, times: Array, entering: Callable[[History], Array], mean: Callable[[History], Array]
    ) -> Array:
        """Inputs at times (n,), s: heat and ambient by `entering`, held temperatures by `mean`."""
        layout = self.layout
        rows = np.zeros((len(times), layout.count + len(self.forces)))
        sources = zip(rows.T[layout.source_columns], self.sources, strict=True)
        for column, (power, history) in sources:
            column[:] = power * entering(history)
        if self.ambient:
            rows[:, layout.ambient] = entering(self.ambient) - self.ambient(np.zeros(1))
        for column, history in zip(rows.T[layout.held_columns], self.held, strict=True):
            column[:] = mean(history)
        for column, history in zip(rows.T[layout.count :], self.forces, strict=True):
            column[:] = history(times)
        return rows

    def reversed_forces(self, ends: Array) -> dict[int, Array]:
        """Return the forces at their reversals within the steps that end at `ends` (n,), s.

        From an index in `ends` to the inputs (k, l) after the thermal ones, in order of time.
        """
        turns = reversals(self.forces, self.step, ends)
        return {
            at: np.stack([history(times) for history in self.forces], axis=1)
            for at, times in turns.items()
        }


def march_inputs(case: Case) -> MarchInputs:
    """Read the histories of a case's inputs.

    Raises
    ------
    InputError
        A file is missing or is not a history.
    """
    own = [source.heat_input is not None for source in case.sources.values()]
    heat = heat_history(None if own and all(own) else case.heat_input)
    factors = [
        step_history(1.0) if load.file is None else read_history(load.file, "factor")
        for load in case.loads.values()
    ]
    return MarchInputs(
        layout=input_layout(case),
        step=case.march.step_s,
        heat=heat,
        sources=[
            (source_power(source), heat_history(source.heat_input) if source.heat_input else heat)
            for source in case.sources.values()
        ]
        # Their heat is known once the axis has moved: `fesim.axes.march`.
        + [(0.0, step_history(0.0)) for _ in heated_by_drives(case)],
        ambient=read_history(case.ambient.file, "ambient_degC") if case.ambient else None,
        held=[held_history(section) for section in case.held_temperatures.values()],
        forces=[*factors, *tightening(case), *([step_history(1.0)] if case.bolts else [])],
    )


def check_turns(case: Case) -> None:
    """Refuse load reversals within a step if the dependent quantities cannot follow.

    Raises
    ------
    InputError
        A load reverses within a step, with frictional heat or a temperature-dependent modulus; or
        as `march_inputs`.
    """
    used = [made for name, made in case.materials.items() if name in case.bodies.values()]
    keys = ["slip_heating"] if any(joint.slip_heating for joint in case.joints.values()) else []
    if any(made.youngs_modulus_factor is not None for made in used):
        keys.append("youngs_modulus_factor")
    if not keys:
        return
    ends = case.march.step_s * np.arange(1.0, step_count(case.march) + 1.0)
    if between := march_inputs(case).reversed_forces(ends):
        raise InputError(
            f"march.step_s: a load turns back within the step to {ends[min(between)]:g} s, which "
            f"{keys[0]} cannot follow; take steps that end where it turns, or leave out {keys[0]}"
        )


def thermal_inputs(case: Case) -> Callable[[float], Array]:
    """Return the inputs of `march_inputs` as a function of the end of one step, s."""
    inputs = march_inputs(case)
    return lambda time: inputs.at(np.array([time]))[0]


def heat_history(given: HeatInput | None) -> History:
    """Return a heat input as a function of time (s)."""
    if isinstance(given, StepInput):
        return step_history(given.level)
    if isinstance(given, RampInput):
        return ramp_history(given.level, 60.0 * given.duration_min)
    if isinstance(given, TriangleInput):
        return triangle_history(given.peak, 60.0 * given.duration_min)
    if isinstance(given, SampledInput):
        return read_history(given.file)
    return step_history(0.0)


def held_history(section: HeldTemperatureSection) -> History:
    """Return a held temperature above the initial ambient, K, as a function of time (s)."""
    if section.file is not None:
        return read_history(section.file, "rise_K")
    return step_history(section.rise_K or 0.0)
