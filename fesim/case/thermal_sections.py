"""Thermal sections of a case: sources, cooling, materials, initial temperature."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from fesim.case.formula import formula
from thermojoint.artefacts.settings.section import (
    Count,
    File,
    Finite,
    Fraction,
    Positive,
    Section,
)


class FactorSection(Section):
    """A temperature-dependent factor: linear between points, constant beyond them."""

    rise_K: Annotated[list[Finite], Field(min_length=1)]
    factor: Annotated[list[Positive], Field(min_length=1)]

    @model_validator(mode="after")
    def _points(self) -> FactorSection:
        if len(self.rise_K) != len(self.factor):
            raise ValueError(
                f"give as many values of 'factor' as of 'rise_K': {len(self.factor)} for "
                f"{len(self.rise_K)}"
            )
        for before, after in pairwise(self.rise_K):
            if after <= before:
                raise ValueError(f"'rise_K' must rise: {after:g} does not come after {before:g}")
        return self


#: Relative to an ambient of at most 100 °C; lower values would be below absolute zero.
Rise = Annotated[float, Field(gt=-373.15, allow_inf_nan=False)]


class MaterialSection(Section):
    """``[materials.NAME]``: properties at the initial ambient; factors with temperature.

    The expansion is the tangent coefficient; strain is its integral.
    """

    conductivity_W_mK: Positive
    density_kg_m3: Positive
    heat_capacity_J_kgK: Positive
    youngs_modulus_GPa: Positive
    poisson_ratio: Annotated[float, Field(gt=-1.0, lt=0.5)]
    expansion_1_K: Finite
    conductivity_factor: FactorSection | None = None
    heat_capacity_factor: FactorSection | None = None
    expansion_factor: FactorSection | None = None
    youngs_modulus_factor: FactorSection | None = None


class StepInput(Section):
    """``[heat_input]`` with ``kind = "step"``."""

    kind: Literal["step"]
    level: Finite


class RampInput(Section):
    """``[heat_input]`` with ``kind = "ramp"``."""

    kind: Literal["ramp"]
    level: Finite
    duration_min: Positive


class TriangleInput(Section):
    """``[heat_input]`` with ``kind = "triangle"``."""

    kind: Literal["triangle"]
    peak: Finite
    duration_min: Positive


class SampledInput(Section):
    """``[heat_input]`` with ``kind = "sampled"``: a CSV with ``time_s,heat_input``."""

    kind: Literal["sampled"]
    file: File


HeatInput = Annotated[
    StepInput | RampInput | TriangleInput | SampledInput, Field(discriminator="kind")
]


class ProfileSection(Section):
    """``[sources.NAME.profile]``, ``[held_temperatures.SURFACE.profile]``: a factor of position.

    Either a formula (`fesim.case.formula`) or a CSV with ``x_mm,y_mm,z_mm`` (or some of them) and
    ``factor`` (`fesim.case.position_table`).
    """

    expression: str | None = None
    file: File | None = None

    @model_validator(mode="after")
    def _one_way(self) -> ProfileSection:
        if (self.expression is None) == (self.file is None):
            raise ValueError("give either 'expression' or 'file'")
        if self.expression is not None:
            formula(self.expression)
        return self


class SourceSection(Section):
    """``[sources.NAME]``: heat that enters through a surface, or in the volume of a body.

    ``reading`` defines ``reference_power_W``: the heat of each of the ``count`` sources of the
    whole machine, or of all of them together. A source without its own ``heat_input`` uses that of
    the case. A ``profile`` distributes the same heat nonuniformly. With ``power_share`` a
    joint-aware model of the case reads the power of a motor or drive; that share of it becomes heat
    here.
    """

    surface: str | None = None
    body: str | None = None
    reference_power_W: Positive
    count: Count = 1
    reading: Literal["per source", "total"] = "per source"
    heat_input: HeatInput | None = None
    profile: ProfileSection | None = None
    power_share: Annotated[float, Field(gt=0.0, le=1.0)] | None = None

    @model_validator(mode="after")
    def _one_region(self) -> SourceSection:
        if (self.surface is None) == (self.body is None):
            raise ValueError("give either 'surface' or 'body'")
        return self


class AmbientSection(Section):
    """``[ambient]``: a CSV with ``time_s,ambient_degC``."""

    file: File


class HeldTemperatureSection(Section):
    """``[held_temperatures.SURFACE]``: above the initial ambient temperature.

    Either constant, or a CSV with ``time_s,rise_K``; a ``profile`` multiplies it.
    """

    rise_K: Rise | None = None
    file: File | None = None
    profile: ProfileSection | None = None

    @model_validator(mode="after")
    def _one_history(self) -> HeldTemperatureSection:
        if (self.rise_K is None) == (self.file is None):
            raise ValueError("give either 'rise_K' or 'file'")
        return self


class InitialTemperatureSection(Section):
    """``[initial_temperature]``: above the initial ambient, everywhere, at time zero.

    One value, a formula, or a file: a CSV with ``x_mm,y_mm,z_mm`` (or some of them) and ``rise_K``,
    or a snapshot (VTU) of another simulation.
    """

    rise_K: Rise | None = None
    expression_K: str | None = None
    file: File | None = None

    @model_validator(mode="after")
    def _one_field(self) -> InitialTemperatureSection:
        given = (self.rise_K, self.expression_K, self.file)
        if sum(field is not None for field in given) != 1:
            raise ValueError("give one of 'rise_K', 'expression_K' and 'file'")
        if self.expression_K is not None:
            formula(self.expression_K)
        return self


class CavitySection(Section):
    """``[cavities.NAME]``: enclosed air of one temperature, with convection at its walls."""

    surfaces: Annotated[list[str], Field(min_length=1)]
    film_W_m2K: Positive


class RadiationSection(Section):
    """``[radiation.SURFACE]``: to surroundings at the ambient temperature.

    ``ambient_degC`` is the ambient at time 0; the surroundings follow its changes.
    """

    emissivity: Fraction
    ambient_degC: Annotated[float, Field(gt=-273.15, allow_inf_nan=False)]
