"""Thermal and mechanical loads and springs of a case in SI."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fesim.case.history import (
    History,
    entering_in_steps,
    mean_over_steps,
    ramp_history,
    read_history,
    reversals,
    step_history,
    triangle_history,
)
from fesim.case.schema import Case
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
from fesim.solid.heat import HeatSource
from fesim.solid.input_layout import InputLayout
from meshes.structure import Structure
from thermojoint.artefacts.arrays import OfPosition


def heat_sources(case: Case, structure: Structure) -> list[HeatSource]:
    """Return the sources of the meshed part, per W of the whole structure, in the case's order."""
    sources = []
    for name, section in case.sources.items():
        if section.surface is not None:
            structure.surface(section.surface, f"sources.{name}.surface")
        else:
            structure.body(section.body or "", f"sources.{name}.body")
        weight = None
        if section.profile is not None:
            weight = profile_of(section.profile, f"sources.{name}.profile", 0.0)
        part = 1.0 / structure.symmetry_factor
        sources.append(HeatSource(part, section.surface, section.body, weight))
    return sources


def held_profiles(case: Case) -> dict[str, OfPosition | None]:
    """Return the factor of position of every held surface; None of those held evenly."""
    return {
        name: None
        if held.profile is None
        else profile_of(held.profile, f"held_temperatures.{name}.profile")
        for name, held in case.held_temperatures.items()
    }


def mechanical_loads(case: Case, structure: Structure) -> list[Load]:
    """Return the forces, pressures and weights on the meshed part, in the case's order.

    Raises
    ------
    InputError
        A load names a surface or a body that is not there.
    """
    loads: list[Load] = []
    for name, load in case.loads.items():
        where = f"loads.{name}"
        if load.acceleration_m_s2 is not None:
            # A wall stands for something of no size: it has no weight.
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
            loads.append(SurfacePressure(surface, 1e6 * load.pressure_MPa))
    return loads


def spring_stiffnesses(case: Case, structure: Structure) -> dict[str, tuple[float, float, float]]:
    """Return the springs under each surface of the meshed part, N/m."""
    part = 1e6 / structure.symmetry_factor
    return {
        name: (part * x, part * y, part * z)
        for name, section in case.supports.springs.items()
        for x, y, z in [section.stiffness_N_um]
    }


def source_power(source: SourceSection) -> float:
    """Heat that a source gives the whole structure at heat input 1, W."""
    each = source.reference_power_W
    return each * source.count if source.reading == "per source" else each


def input_layout(case: Case) -> InputLayout:
    """Return the order of the inputs of a case's march."""
    return InputLayout(len(case.sources), len(case.held_temperatures))


def thermal_inputs(case: Case) -> Callable[[float], NDArray[np.float64]]:
    """Return the inputs of the march in time, in the order of `input_layout`.

    Behind them stand the factors of the mechanical loads, then what the bolts are given (N), and
    with them a 1 (`fesim.solid.bolts.fastened`).
    """
    table = input_table(case)
    return lambda time: table(np.array([time]))[0]


def input_table(case: Case) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the inputs of `thermal_inputs` as a function of many times (n,), s: a row for each.

    The times are ends of the case's steps. Heat and ambient count as `entering_in_steps`, held
    temperatures as `mean_over_steps`, forces as they are at the end.
    """
    layout, step = input_layout(case), case.march.step_s
    sources = [
        (source_power(source), heat_history(source.heat_input or case.heat_input))
        for source in case.sources.values()
    ]
    ambient = read_history(case.ambient.file, "ambient_degC") if case.ambient else None
    held = [held_history(section) for section in case.held_temperatures.values()]
    behind = _force_histories(case)

    def inputs(times: NDArray[np.float64]) -> NDArray[np.float64]:
        rows = np.zeros((len(times), layout.count + len(behind)))
        for column, (power, history) in zip(rows.T[layout.source_columns], sources, strict=True):
            column[:] = power * entering_in_steps(history, step, times)
        if ambient:
            found = entering_in_steps(ambient, step, times)
            rows[:, layout.ambient] = found - ambient(np.zeros(1))
        for column, history in zip(rows.T[layout.held_columns], held, strict=True):
            column[:] = mean_over_steps(history, step, times)
        for column, history in zip(rows.T[layout.count :], behind, strict=True):
            column[:] = history(times)
        return rows

    return inputs


def forces_between(case: Case, ends: NDArray[np.float64]) -> dict[int, NDArray[np.float64]]:
    """Return what loads and bolts are where they turn back within a step.

    Parameters
    ----------
    case : Case
        With its loads and bolts.
    ends : ndarray, shape (n,)
        Ends of steps, s.

    Returns
    -------
    dict of int to ndarray, shape (k, l)
        Place in `ends` to what stands behind the thermal inputs of the march, in order of time.
    """
    behind = _force_histories(case)
    found = reversals(behind, case.march.step_s, ends)
    return {
        at: np.stack([history(times) for history in behind], axis=1) for at, times in found.items()
    }


def _force_histories(case: Case) -> list[History]:
    """Inputs after the thermal ones: load factors, bolt forces (N) and a 1 for these."""
    factors = [
        step_history(1.0) if load.file is None else read_history(load.file, "factor")
        for load in case.loads.values()
    ]
    return [*factors, *tightening(case), *([step_history(1.0)] if case.bolts else [])]


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
