"""The case: one TOML file that says everything about a simulation, validated before any work.

Units stand in the key names; everything is turned into SI by `fesim.setup.machine`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import BaseModel, Field, model_validator

from artefacts import toml
from artefacts.errors import InputError, unknown_name
from artefacts.refusal import first_error, keys_at, quoting, refusal
from fesim.case.bolts import BoltSection
from fesim.case.section import STRICT, Finite, NotNegative, Point, Positive
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

#: More steps than this in one run, or contact elements in one joint, are a slip: the response, or
#: the dense matrices of the joint, would not fit into any memory.
MOST_STEPS = 10_000_000
#: A time may lie after a step by this fraction of the step and still be that step.
TIME_SLACK = 1e-6
MOST_CONTACTS = 4_000


class _Section(BaseModel):
    model_config = STRICT


class MillingMachineSection(_Section):
    """``[structure]`` with ``kind = "box_milling_machine"``."""

    kind: Literal["box_milling_machine"]
    element_size_mm: Positive = 50.0
    joint_element_size_mm: Positive | None = None
    half: bool = True
    dimensions_mm: dict[str, Positive] = {}


class MeshSection(_Section):
    """``[structure]`` with ``kind = "mesh"``: a file that meshio reads."""

    kind: Literal["mesh"]
    file: Path
    unit: Literal["m", "cm", "mm", "in"] = "m"
    symmetry_factor: Annotated[int, Field(ge=1)] = 1


class BackBurdekinSection(_Section):
    """``[joints.NAME.back_burdekin]``: approach = coefficient * pressure^exponent, um and MPa."""

    coefficient_um: Positive
    exponent: Annotated[float, Field(gt=0.0, le=1.0)]


class ConductanceSection(_Section):
    """``[joints.NAME.conductance]``: which constants of Eq. 11, or what stands in its place.

    ``file`` is a CSV with ``pressure_MPa,conductance_W_m2K``, and ``rise_K`` if h depends on it.
    """

    law: Literal[
        "cmy-1969", "yovanovich-1982", "cmy-exact", "constants", "fixed", "table", "none"
    ] = "cmy-1969"
    constant: Positive | None = None
    exponent: Positive | None = None
    value_W_m2K: NotNegative | None = None
    file: Path | None = None

    @model_validator(mode="after")
    def _constants_go_with_their_law(self) -> ConductanceSection:
        given = self.constant is not None, self.exponent is not None
        if (self.law == "constants") != all(given) or any(given) != all(given):
            raise ValueError("'constant' and 'exponent' go with law = \"constants\", both of them")
        if (self.law == "fixed") != (self.value_W_m2K is not None):
            raise ValueError("'value_W_m2K' goes with law = \"fixed\", and only with it")
        if (self.law == "table") != (self.file is not None):
            raise ValueError("'file' goes with law = \"table\", and only with it")
        return self


class GapSection(_Section):
    """``[joints.NAME.gap]``: what passes heat beside the contact, open or closed."""

    gas_conductivity_W_mK: NotNegative = 0.0
    temperature_jump_um: NotNegative = 0.0
    emissivity_a: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    emissivity_b: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    mean_temperature_degC: Annotated[float, Field(gt=-273.15, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _something_conducts(self) -> GapSection:
        radiation = self.emissivity_a, self.emissivity_b, self.mean_temperature_degC
        given = [value is not None for value in radiation]
        if any(given) and not all(given):
            raise ValueError(
                "radiation needs 'emissivity_a', 'emissivity_b' and 'mean_temperature_degC', all "
                "of them"
            )
        if self.gas_conductivity_W_mK == 0.0 and not any(given):
            raise ValueError("give 'gas_conductivity_W_mK', or both emissivities")
        return self


class JointSection(_Section):
    """``[joints.NAME]``: contact elements, surfaces and friction of one joint.

    What is one machine's has no default: preload, surfaces, friction. A joint without preload
    starts open by ``initial_opening_um``, or by what separates its sides in the mesh.
    ``tangential_stiffness_ratio`` is Mindlin's 2(1-v)/(2-v), by default for v = 0.27; it is 0.86
    for v = 0.25 and 0.80 for v = 0.33.
    """

    side_a: str | None = None
    side_b: str | None = None
    preload_MPa: NotNegative
    reference_pressure_MPa: Positive | None = None
    initial_opening_um: Finite | Literal["mesh"] | None = None
    along: Annotated[int, Field(ge=1)]
    across: Annotated[int, Field(ge=1)] = 1
    roughness_um: Positive
    asperity_slope: Positive
    hardness_GPa: Positive
    normal_law: Literal["surface", "back-burdekin"] = "surface"
    back_burdekin: BackBurdekinSection | None = None
    conductance: ConductanceSection = ConductanceSection()
    gap: GapSection | None = None
    friction_coefficient: NotNegative
    tangential_stiffness_ratio: Positive = 0.844

    @model_validator(mode="after")
    def _preload_or_opening(self) -> JointSection:
        if self.preload_MPa > 0.0:
            if self.initial_opening_um is not None or self.reference_pressure_MPa is not None:
                raise ValueError(
                    "'initial_opening_um' and 'reference_pressure_MPa' are for a joint without "
                    "preload; set preload_MPa = 0, or leave them out"
                )
            return self
        if self.initial_opening_um is None or self.reference_pressure_MPa is None:
            raise ValueError(
                "preload_MPa = 0 needs 'initial_opening_um' (0 if the sides touch, or \"mesh\") "
                "and 'reference_pressure_MPa', at which the stiffness is taken"
            )
        if self.initial_opening_um != "mesh" and self.initial_opening_um < 0.0:
            raise ValueError(
                "initial_opening_um is negative: the joint starts interpenetrated; give 0 or "
                "more, or a preload_MPa"
            )
        return self

    @model_validator(mode="after")
    def _preload_below_hardness(self) -> JointSection:
        if self.preload_MPa >= 500.0 * self.hardness_GPa:
            raise ValueError("preload_MPa must be below half of the hardness")
        if (self.reference_pressure_MPa or 0.0) >= 500.0 * self.hardness_GPa:
            raise ValueError("reference_pressure_MPa must be below half of the hardness")
        if self.along * self.across > MOST_CONTACTS:
            raise ValueError(
                f"along x across is more than {MOST_CONTACTS} contact elements a patch"
            )
        if (self.side_a is None) != (self.side_b is None):
            raise ValueError("give both side_a and side_b, or neither")
        if self.normal_law == "back-burdekin" and self.back_burdekin is None:
            raise ValueError(
                'normal_law = "back-burdekin" needs back_burdekin = { coefficient_um = ..., '
                "exponent = ... }"
            )
        return self


class WallSection(_Section):
    """``[walls.NAME]``: a rigid body that lies against a surface; a joint takes it as a side.

    It has the temperature that ``[held_temperatures.NAME]`` gives; without one, no heat passes.
    """

    faces: str


class SpringSection(_Section):
    """``[supports.springs.SURFACE]``: levelling mounts, spread evenly over a surface."""

    stiffness_N_um: tuple[NotNegative, NotNegative, NotNegative]


class SupportsSection(_Section):
    """``[supports]``: surfaces held in all directions, symmetry planes, and springs."""

    fixed: list[str] = []
    symmetry: dict[str, Literal["x", "y", "z"]] = {}
    springs: dict[str, SpringSection] = {}


class LoadSection(_Section):
    """``[loads.NAME]``: a force, a pressure, or an acceleration of bodies, as gravity is one.

    ``force_N`` is that of the whole structure, spread evenly over its surface. A load is constant
    from the start, or multiplied by the ``factor`` of a CSV with ``time_s,factor``.
    """

    surface: str | None = None
    force_N: Point | None = None
    pressure_MPa: Finite | None = None
    acceleration_m_s2: Point | None = None
    bodies: Annotated[list[str], Field(min_length=1)] | None = None
    file: Path | None = None

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


class MarchSection(_Section):
    """``[march]``."""

    step_s: Positive
    duration_min: Positive
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


def step_count(march: MarchSection) -> int:
    """Steps of a whole march: its last one ends at, or first after, the duration."""
    return first_step_at(60.0 * march.duration_min, march.step_s)


def first_step_at(time: float, length: float) -> int:
    """Index of the first step of `length` (s) that ends at or after `time` (s)."""
    return max(1, math.ceil(time / length - TIME_SLACK))


class ProbeSection(_Section):
    """``[probes.NAME]``."""

    position_mm: Point
    body: str | None = None


class DisplacementSection(_Section):
    """``[displacement]``: the displacement that is recorded, of one point or between two."""

    point: str
    relative_to: str | None = None


class CandidatesSection(_Section):
    """``[candidates]``: a lattice of possible sensors in one body, for the placement rule."""

    body: str
    low_mm: Point
    high_mm: Point
    spacing_mm: Positive


class OutputSection(_Section):
    """``[output]``.

    ``forces`` asks for what supports and joints bear; ``stress_probes`` are names of ``[probes]``.
    """

    snapshots_s: list[NotNegative] = []
    forces: bool = False
    stress_probes: list[str] = []


class Case(_Section):
    """A whole case file."""

    title: str
    structure: Annotated[MillingMachineSection | MeshSection, Field(discriminator="kind")]
    materials: dict[str, MaterialSection]
    bodies: dict[str, str]
    joints: dict[str, JointSection] = {}
    walls: dict[str, WallSection] = {}
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
    displacement: DisplacementSection
    probes: dict[str, ProbeSection] = {}
    candidates: list[CandidatesSection] = []
    output: OutputSection = OutputSection()

    @model_validator(mode="after")
    def _something_heats(self) -> Case:
        acting = (
            self.sources,
            self.held_temperatures,
            self.ambient,
            self.initial_temperature,
            self.loads,
            self.bolts,
        )
        if not any(acting):
            raise ValueError("nothing heats the structure: add [sources.NAME]")
        for name, source in self.sources.items():
            if source.heat_input is None and self.heat_input is None:
                raise ValueError(f"source {name!r} has no heat input: add [heat_input]")
        return self

    @model_validator(mode="after")
    def _one_film_a_surface(self) -> Case:
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
        if self.bolts and (growing := growth_sections(self)):
            raise ValueError(
                f"{growing[0]}: bolts are condensed with bodies of constant expansion; leave out "
                "either of them"
            )
        return self

    @model_validator(mode="after")
    def _marched_by_its_model(self) -> Case:
        if (reason := not_reducible(self)) is not None:
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
    """Return the sections that make the heat equation of a case depend on temperature."""
    return [
        *(f"convection_factor.{name}" for name in case.convection_factor),
        *(f"radiation.{name}" for name in case.radiation),
        *(f"cavities.{name}" for name in case.cavities),
        *(
            f"materials.{name}.conductivity_factor"
            for name, material in case.materials.items()
            if material.conductivity_factor is not None
        ),
    ]


def growth_sections(case: Case) -> list[str]:
    """Return the sections that make expansion depend on temperature."""
    return [
        f"materials.{name}.expansion_factor"
        for name, material in case.materials.items()
        if material.expansion_factor is not None
    ]


def not_reducible(case: Case) -> str | None:
    """Return why the reduced model that a case asks for cannot march it; None if it can."""
    found = [*secant_sections(case), *growth_sections(case)]
    if not found or case.march.thermal == "full":
        return None
    return (
        f"{found[0]}: modes are those of constant properties and films to the ambient, and "
        'temperatures of nodes are not among them; take thermal = "full" in [march]'
    )


def read_case(path: Path | str) -> Case:
    """Read and validate a case file.

    Parameters
    ----------
    path : Path or str
        TOML; relative file names in it are relative to its folder.

    Raises
    ------
    InputError
        The file is missing or no TOML, a key is unknown or missing, or a value is out of range.
    """
    path = Path(path)
    return parse_case(toml.read_text(path, "case"), str(path), path.parent)


def parse_case(text: str, where: str, folder: Path) -> Case:
    """Validate the text of a case file; see `read_case`."""
    return case_from_data(toml.parse(text, where), where, folder)


def case_from_data(data: dict[str, Any], where: str, folder: Path) -> Case:
    """Validate a case given as nested dictionaries.

    Parameters
    ----------
    data : dict
        What a case file says, e.g. from `tomllib.loads`.
    where : str
        What error messages call it.
    folder : Path
        Relative file names are relative to it.

    Raises
    ------
    InputError
        A key is unknown or missing, or a value is out of range.
    """
    try:
        # Absolute: a worker of a batch may stand in another folder.
        return Case.model_validate(with_files(data, lambda name: str((folder / name).absolute())))
    except pydantic.ValidationError as error:
        raise _one_line(error, where) from error


#: Sections that may name a ``file``; ``*`` stands for any name. Elsewhere ``file`` is a name like
#: any other, e.g. of a body.
_FILE_SECTIONS = (
    ("structure",),
    ("heat_input",),
    ("sources", "*", "heat_input"),
    ("sources", "*", "profile"),
    ("ambient",),
    ("initial_temperature",),
    ("held_temperatures", "*"),
    ("held_temperatures", "*", "profile"),
    ("loads", "*"),
    ("bolts", "*"),
    ("joints", "*", "conductance"),
)


def with_files(data: dict[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return a case's data with every file name in it changed.

    Parameters
    ----------
    data : dict
        As read from TOML, valid or not, or dumped from a `Case`; sections may be missing.
    change : callable
        File name to what stands in its place.
    """
    for place in _FILE_SECTIONS:
        data = _with_file_at(place, data, change)
    return data


def _with_file_at(place: tuple[str, ...], data: Any, change: Callable[[str], str]) -> Any:  # noqa: ANN401
    if not isinstance(data, dict):
        return data
    if not place:
        name = data.get("file")
        return data | {"file": change(name)} if isinstance(name, str) else data
    keys = [key for key in data if place[0] in ("*", key)]
    return data | {key: _with_file_at(place[1:], data[key], change) for key in keys}


#: Sections of several kinds: pydantic puts the kind into a location, behind the section.
_KIND_SECTIONS = (("structure",), ("heat_input",), ("sources", "*", "heat_input"))


def _one_line(error: pydantic.ValidationError, where: str) -> InputError:
    first = first_error(error)
    place = _without_kind([str(part) for part in first["loc"]]) or ["case"]
    if first["type"] != "extra_forbidden":
        return refusal(first, f"{where}: {'.'.join(place)}")
    *section, key = place
    refused = unknown_name("key", key, keys_at(Case, section), ".".join([where, *section]))
    if section and isinstance(first["input"], dict):
        return InputError(f"{refused}; {quoting(f'{section[-1]}.{key}')}")
    return refused


def _without_kind(place: list[str]) -> list[str]:
    for section in _KIND_SECTIONS:
        size = len(section)
        if len(place) > size and all(
            known in ("*", part) for known, part in zip(section, place, strict=False)
        ):
            return place[:size] + place[size + 1 :]
    return place
