"""Schema of the case: one TOML file that defines a simulation, validated before any work.

Key names contain the units; `fesim.setup.machine` converts everything to SI.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from fesim.case.axis_section import AxisSection, VolumeSection, not_asked, seats_of
from fesim.case.bolts import BoltSection
from fesim.case.joint_sections import JointSection, WallSection
from fesim.case.thermal_sections import (
    AmbientSection,
    CavitySection,
    FactorSection,
    HeatInput,
    HeldTemperatureSection,
    InitialTemperatureSection,
    MaterialSection,
    RadiationSection,
    SourceSection,
)
from thermojoint.artefacts.display import Described, counted
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import read_settings, settings_from
from thermojoint.artefacts.settings.section import (
    Count,
    File,
    Finite,
    NotNegative,
    Point,
    Positive,
    Section,
)

#: More steps than this in one run are a mistake: the response would not fit into any memory.
MOST_STEPS = 10_000_000
#: Default tolerances of an adaptive march: displacement, um; temperature, K.
TOLERANCE_UM, TOLERANCE_K = 0.01, 0.5
#: A time may be after a step by this fraction of the step and still count as that step.
TIME_SLACK = 1e-6


class MillingMachineSection(Section):
    """``[structure]`` with ``kind = "box_milling_machine"``."""

    kind: Literal["box_milling_machine"]
    element_size_mm: Positive = 50.0
    joint_element_size_mm: Positive | None = None
    half: bool = True
    dimensions_mm: dict[str, Positive] = {}


class MeshSection(Section):
    """``[structure]`` with ``kind = "mesh"``: a file that meshio reads."""

    kind: Literal["mesh"]
    file: File
    unit: Literal["m", "cm", "mm", "in"] = "m"
    symmetry_factor: Count = 1


class SpringSection(Section):
    """``[supports.springs.SURFACE]``: levelling mounts, distributed uniformly over a surface."""

    stiffness_N_um: Annotated[tuple[NotNegative, NotNegative, NotNegative], Field(strict=False)]


class SupportsSection(Section):
    """``[supports]``: fixed surfaces, symmetry planes, and springs."""

    fixed: list[str] = []
    symmetry: dict[str, Literal["x", "y", "z"]] = {}
    springs: dict[str, SpringSection] = {}


class LoadSection(Section):
    """``[loads.NAME]``: a force, a pressure, or an acceleration of bodies such as gravity.

    ``force_N`` acts on the whole structure, distributed uniformly over its surface. A load is
    constant from the start, or multiplied by the ``factor`` of a CSV with ``time_s,factor``.
    """

    surface: str | None = None
    force_N: Point | None = None
    pressure_MPa: Finite | None = None
    acceleration_m_s2: Point | None = None
    bodies: Annotated[list[str], Field(min_length=1)] | None = None
    file: File | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> LoadSection:
        kinds = (self.force_N, self.pressure_MPa, self.acceleration_m_s2)
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("give one of 'force_N', 'pressure_MPa' and 'acceleration_m_s2'")
        if (self.acceleration_m_s2 is None) != (self.surface is not None):
            raise ValueError(
                "'force_N' and 'pressure_MPa' need the 'surface' they act on, "
                "'acceleration_m_s2' has none"
            )
        if self.bodies is not None and self.acceleration_m_s2 is None:
            raise ValueError("'bodies' go with 'acceleration_m_s2'")
        return self


class MarchSection(Section):
    """``[march]``."""

    step_s: Positive
    duration_min: Positive
    method: Literal["fixed", "adaptive"] = "fixed"
    tolerance_um: Positive | None = None
    tolerance_K: Positive | None = None
    coupling: Literal["staggered", "iterated"] = "staggered"
    thermal: Literal["reduced", "full"] = "reduced"
    solver: Literal["pardiso", "superlu"] | None = None

    @model_validator(mode="after")
    def _one_step_or_more(self) -> MarchSection:
        if self.duration_min * 60.0 < self.step_s:
            raise ValueError("duration_min is shorter than one step of step_s")
        if self.duration_min * 60.0 > MOST_STEPS * self.step_s:
            raise ValueError(f"duration_min has more than {MOST_STEPS} steps of step_s")
        return self

    @model_validator(mode="after")
    def _errors_estimated(self) -> MarchSection:
        tolerances = (self.tolerance_um, self.tolerance_K)
        if self.method == "fixed" and tolerances != (None, None):
            raise ValueError(
                'tolerance_um and tolerance_K belong to method = "adaptive"; leave them out for '
                "steps of one length"
            )
        if self.method == "adaptive" and self.thermal == "full":
            raise ValueError(
                'method = "adaptive" integrates modes exactly; take thermal = "reduced", or '
                'method = "fixed"'
            )
        if self.method == "adaptive" and self.coupling == "iterated":
            raise ValueError(
                'coupling = "iterated" belongs to method = "fixed": in adaptive steps pressure and '
                "conductance agree by themselves; leave it out"
            )
        return self


def step_count(march: MarchSection) -> int:
    """Number of steps of a march: the last is the first that ends at or after the duration."""
    return first_step_at(60.0 * march.duration_min, march.step_s)


def first_step_at(time: float, length: float) -> int:
    """Index of the first step of `length` (s) that ends at or after `time` (s)."""
    return max(1, math.ceil(time / length - TIME_SLACK))


class ProbeSection(Section):
    """``[probes.NAME]``."""

    position_mm: Point
    body: str | None = None


class DisplacementSection(Section):
    """``[displacement]``: the recorded displacement, of one point or between two.

    Without it only heat is simulated.
    """

    point: str
    relative_to: str | None = None
    tool_mm: Point | None = None
    tool_within_mm: Positive | None = None

    @model_validator(mode="after")
    def _turns_a_tool(self) -> DisplacementSection:
        if (self.tool_mm is None) != (self.tool_within_mm is None):
            raise ValueError(
                "tool_mm and tool_within_mm: where the tip of the tool is from the point, and how "
                "near nodes show how the point turns; give both, or neither"
            )
        return self


class CandidatesSection(Section):
    """``[candidates]``: a lattice of possible sensors in one body, for the placement rule."""

    body: str
    low_mm: Point
    high_mm: Point
    spacing_mm: Positive


class OutputSection(Section):
    """``[output]``.

    ``forces`` requests reactions and joint forces; ``stress_probes`` are names of ``[probes]``.
    """

    snapshots_s: list[NotNegative] = []
    forces: bool = False
    stress_probes: list[str] = []

    @model_validator(mode="after")
    def _each_stress_once(self) -> OutputSection:
        for name in self.stress_probes:
            if self.stress_probes.count(name) > 1:
                raise ValueError(f"stress_probes: {name!r} is named twice")
        return self


class Case(Described, Section):
    """A whole case file."""

    title: str
    structure: Annotated[MillingMachineSection | MeshSection, Field(discriminator="kind")]
    materials: dict[str, MaterialSection]
    bodies: dict[str, str]
    joints: dict[str, JointSection] = {}
    walls: dict[str, WallSection] = {}
    axes: dict[str, AxisSection] = {}
    volume: VolumeSection | None = None
    supports: SupportsSection
    convection_W_m2K: dict[str, NotNegative] = {}
    convection_factor: dict[str, FactorSection] = {}
    radiation: dict[str, RadiationSection] = {}
    cavities: dict[str, CavitySection] = {}
    sources: dict[str, SourceSection] = {}
    heat_input: HeatInput | None = None
    ambient: AmbientSection | None = None
    initial_temperature: InitialTemperatureSection | None = None
    held_temperatures: dict[str, HeldTemperatureSection] = {}
    loads: dict[str, LoadSection] = {}
    bolts: dict[str, BoltSection] = {}
    march: MarchSection
    displacement: DisplacementSection | None = None
    probes: dict[str, ProbeSection] = {}
    candidates: list[CandidatesSection] = []
    output: OutputSection = OutputSection()

    def replace(self, **changes: Any) -> Case:  # noqa: ANN401 - what a case file may say
        """Return this case with changes, checked like a case file.

        Parameters
        ----------
        **changes
            New value of each key: a section, or a dictionary that is merged into the present
            section. A section of another ``kind`` replaces the present one.

        Raises
        ------
        InputError
            A key is unknown, or a value is out of range.

        Examples
        --------
        >>> case.replace(march={"step_s": 20.0})  # doctest: +SKIP
        """
        data = self.model_dump(mode="json", exclude_unset=True)
        return case_from_data(_merged(data, changes), self.title, Path())

    def _facts(self) -> dict[str, str]:
        march = self.march
        return {
            "title": self.title,
            "bodies": ", ".join(self.bodies),
            "joints": ", ".join(self.joints) or "none",
            "probes": counted(len(self.probes), "probe"),
            "march": f"{march.duration_min:g} min in steps of {march.step_s:g} s",
        }

    @model_validator(mode="after")
    def _something_heats(self) -> Case:
        acting = (
            self.sources,
            self.held_temperatures,
            self.ambient,
            self.initial_temperature,
            self.loads,
            self.bolts,
            heated_by_drives(self),
        )
        if not any(acting):
            raise ValueError("nothing heats the structure: add [sources.NAME]")
        for name, source in self.sources.items():
            if source.heat_input is None and self.heat_input is None:
                raise ValueError(f"source {name!r} has no heat input: add [heat_input]")
        return self

    @model_validator(mode="after")
    def _one_coefficient_per_surface(self) -> Case:
        for name in self.convection_factor:
            if name not in self.convection_W_m2K:
                raise ValueError(f"convection_factor.{name}: add its film to [convection_W_m2K]")
        taken = [*self.convection_W_m2K, *self.radiation]
        for name, cavity in self.cavities.items():
            for surface in cavity.surfaces:
                if surface in taken:
                    raise ValueError(
                        f"cavities.{name}: surface {surface!r} gives off heat elsewhere as well, "
                        "to the ambient or another cavity; leave it out there"
                    )
                taken.append(surface)
        if self.bolts and (growing := solid_sections(self)):
            raise ValueError(
                f"{growing[0]}: bolts need bodies of constant expansion and modulus; leave out "
                "the factor or the bolts"
            )
        return self

    @model_validator(mode="after")
    def _friction_heats_both_sides(self) -> Case:
        adiabatic = set(self.walls) - set(self.held_temperatures)
        for name, joint in self.joints.items():
            if not joint.slip_heating:
                continue
            if walls := sorted(adiabatic & {joint.side_a, joint.side_b} - {None}):
                raise ValueError(
                    f"joints.{name}.slip_heating: the wall {walls[0]!r} has no temperature, so it "
                    f"takes no heat; add [held_temperatures.{walls[0]}], or leave out slip_heating"
                )
            if self.march.method == "adaptive":
                raise ValueError(
                    f"joints.{name}.slip_heating: adaptive steps do not count the heat of "
                    'friction; take march.method = "fixed", or leave out slip_heating'
                )
        return self

    @model_validator(mode="after")
    def _deforms_if_asked(self) -> Case:
        if self.displacement is None and (sections := deforming_sections(self)):
            raise ValueError(
                f"{sections[0]} needs the deformation of the structure; add [displacement]"
            )
        return self

    @model_validator(mode="after")
    def _marched_by_its_model(self) -> Case:
        if (reason := not_reducible(self) or not_softening(self)) is not None:
            raise ValueError(reason)
        return self

    @model_validator(mode="after")
    def _moves_as_it_can(self) -> Case:
        if (reason := not_movable(self)) is not None:
            raise ValueError(reason)
        return self

    @model_validator(mode="after")
    def _snapshots_in_the_march(self) -> Case:
        end = self.march.step_s * step_count(self.march)
        for time in self.output.snapshots_s:
            if time > end:
                raise ValueError(
                    f"output.snapshots_s: {time:g} s is after the end at {end:g} s; leave it out "
                    "or make march.duration_min longer"
                )
        return self


def secant_sections(case: Case) -> list[str]:
    """Return the sections that make the heat equation of a case temperature-dependent."""
    return [
        *(f"convection_factor.{name}" for name in case.convection_factor),
        *(f"radiation.{name}" for name in case.radiation),
        *(f"cavities.{name}" for name in case.cavities),
        *(
            f"materials.{name}.{key}"
            for name, material in case.materials.items()
            for key in ("conductivity_factor", "heat_capacity_factor")
            if getattr(material, key) is not None
        ),
    ]


def deforming_sections(case: Case) -> list[str]:
    """Return the sections, other than ``[displacement]``, that need the structure's deformation."""
    asked = case.output.snapshots_s or case.output.forces or case.output.stress_probes
    return [
        *(f"loads.{name}" for name in case.loads),
        *(f"bolts.{name}" for name in case.bolts),
        *(
            f"joints.{name}"
            for name, joint in case.joints.items()
            if joint.conductance.law not in ("fixed", "none")
            or (joint.gap is not None and joint.gap.gas_conductivity_W_mK > 0.0)
            or joint.slip_heating
        ),
        *(["output"] if asked else []),
        *(['march.method = "adaptive"'] if case.march.method == "adaptive" else []),
    ]


def solid_sections(case: Case) -> list[str]:
    """Return the sections that make expansion or modulus temperature-dependent."""
    return [
        f"materials.{name}.{key}"
        for name, material in case.materials.items()
        for key in ("expansion_factor", "youngs_modulus_factor")
        if getattr(material, key) is not None
    ]


def not_softening(case: Case) -> str | None:
    """Return why a temperature-dependent modulus cannot be used; None if it can or is not."""
    soft = [name for name in solid_sections(case) if name.endswith("youngs_modulus_factor")]
    if not soft or not (case.output.forces or case.output.stress_probes):
        return None
    refused = "output.forces" if case.output.forces else "output.stress_probes"
    return f"{refused}: not with {soft[0]} so far; leave out one of them"


def not_reducible(case: Case) -> str | None:
    """Return why a case cannot use the reduced model that it requests; None if it can."""
    sections = [*secant_sections(case), *solid_sections(case)]
    if not sections or case.march.thermal == "full":
        return None
    return (
        f"{sections[0]}: the reduced thermal model has constant properties and convects to the "
        'ambient only; set thermal = "full" in [march]'
    )


def not_movable(case: Case) -> str | None:
    """Return why a case cannot move along its axes; None if it can, or has none."""
    riding = {joint.axis for joint in case.joints.values() if joint.axis is not None}
    for name in sorted(riding - set(case.axes)):
        return f"joints: axis {name!r} has no section; add [axes.{name}]"
    for name in case.axes:
        if name not in riding:
            return f'axes.{name}: no joint rides on it; give one axis = "{name}"'
    if case.volume is not None:
        end = case.march.step_s * step_count(case.march)
        if (reason := not_asked(case.volume, case.axes, end)) is not None:
            return reason
    if not case.axes:
        return None
    shown = {axis.rotation_within_mm for axis in case.axes.values()} - {None}
    if len(shown) > 1:
        return "axes: rotation_within_mm is that of the machine's points; give it once"
    if case.displacement is None:
        return "axes: joints on an axis need the deformation of the structure; add [displacement]"
    if (reason := not_driven(case)) is not None:
        return reason
    asked = case.output.snapshots_s or case.output.forces or case.output.stress_probes
    refused = [
        *(f"loads.{name}" for name in case.loads),
        *(f"bolts.{name}" for name in case.bolts),
        *(f"walls.{name}" for name in case.walls),
        *(f"joints.{name}.slip_heating" for name, j in case.joints.items() if j.slip_heating),
        *(["output"] if asked else []),
        *(['march.method = "adaptive"'] if case.march.method == "adaptive" else []),
        *(['march.thermal = "full"'] if case.march.thermal == "full" else []),
    ]
    return f"{refused[0]}: not with [axes] so far; leave it out" if refused else None


def heated_by_drives(case: Case) -> dict[str, str]:
    """Return the surfaces heated by drives, by source name; they follow the case's own sources."""
    return {
        f"{name} {part}": surface
        for name, axis in case.axes.items()
        if axis.ball_screw is not None
        for part, surface in axis.ball_screw.surfaces().items()
    }


def not_driven(case: Case) -> str | None:
    """Return what is missing for the drives of a case; None if nothing is."""
    for name, axis in case.axes.items():
        if axis.ball_screw is not None and axis.ball_screw.material not in case.materials:
            made = axis.ball_screw.material
            return (
                f"axes.{name}.ball_screw: no material {made!r}; add it to [materials], or name one "
                "of those"
            )
        if axis.scale is not None and axis.scale.follows not in {None, *case.probes}:
            return (
                f"axes.{name}.scale: no probe {axis.scale.follows!r} to follow; add it to [probes]"
            )
        for seat in seats_of(axis):
            if seat not in {None, *case.probes}:
                return f"axes.{name}: no probe {seat!r} to sit at; add it to [probes]"
    return None


def read_case(path: Path | str) -> Case:
    """Read and validate a case file.

    Parameters
    ----------
    path : Path or str
        TOML file; file names in it are relative to its folder.

    Raises
    ------
    InputError
        The file is missing or not TOML, a key is unknown or missing, or a value is out of range:
        one line for every mistake.
    """
    return read_settings(Case, Path(path), "case")


def parse_case(text: str, where: str, folder: Path) -> Case:
    """Validate the text of a case file; see `read_case`."""
    return case_from_data(toml.parse(text, where), where, folder)


def case_from_data(data: dict[str, Any], where: str, folder: Path) -> Case:
    """Validate a case given as nested dictionaries.

    Parameters
    ----------
    data : dict
        Content of a case file, e.g. from `tomllib.loads`.
    where : str
        Name of the case in error messages.
    folder : Path
        Relative file names are relative to it.

    Raises
    ------
    InputError
        A key is unknown or missing, or a value is out of range: one line for every mistake.
    """
    return settings_from(Case, data, where, folder)


def _merged(data: Any, changes: Any) -> Any:  # noqa: ANN401 - nested dictionaries
    """Return nested dictionaries with changes; sections in them become dictionaries."""
    if isinstance(changes, Section):
        return changes.model_dump(mode="json", exclude_unset=True)
    if not isinstance(changes, dict):
        return changes
    kept = data if isinstance(data, dict) else {}
    if changes.get("kind", kept.get("kind")) != kept.get("kind"):
        kept = {}
    return kept | {key: _merged(kept.get(key), value) for key, value in changes.items()}
