"""Sections of a case for joints: sides, laws, conductances, gaps, rigid walls."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from thermojoint.artefacts.settings.section import (
    Count,
    File,
    Finite,
    Fraction,
    NotNegative,
    Positive,
    Section,
)

#: More contact elements than this in one joint are a mistake: the dense matrices of the joint would
#: not fit into any memory.
MOST_CONTACTS = 4_000


class BackBurdekinSection(Section):
    """``[joints.NAME.back_burdekin]``: approach = coefficient * pressure^exponent, um and MPa."""

    coefficient_um: Positive
    exponent: Fraction


class ConductanceSection(Section):
    """``[joints.NAME.conductance]``: constants of Eq. 11, or another conductance.

    ``file`` is a CSV with ``pressure_MPa,conductance_W_m2K``, and ``rise_K`` if h depends on it.
    """

    law: Literal[
        "cmy-1969", "yovanovich-1982", "cmy-exact", "constants", "fixed", "table", "none"
    ] = "cmy-1969"
    constant: Positive | None = None
    exponent: Positive | None = None
    value_W_m2K: NotNegative | None = None
    file: File | None = None

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


class GapSection(Section):
    """``[joints.NAME.gap]``: heat transfer in parallel with the contact, open or closed.

    Radiation is linearised at ``mean_temperature_degC``, or not at all: then ``ambient_degC`` is
    the ambient at time 0, the reference of the temperatures.
    """

    gas_conductivity_W_mK: NotNegative = 0.0
    temperature_jump_um: NotNegative = 0.0
    emissivity_a: Fraction | None = None
    emissivity_b: Fraction | None = None
    mean_temperature_degC: Annotated[float, Field(gt=-273.15, allow_inf_nan=False)] | None = None
    ambient_degC: Annotated[float, Field(gt=-273.15, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _something_conducts(self) -> GapSection:
        radiation = self.emissivity_a, self.emissivity_b
        temperatures = self.mean_temperature_degC, self.ambient_degC
        given = [value is not None for value in radiation]
        known = sum(value is not None for value in temperatures)
        if (any(given) or known) and not (all(given) and known == 1):
            raise ValueError(
                "radiation needs 'emissivity_a', 'emissivity_b' and one of 'ambient_degC' and "
                "'mean_temperature_degC'"
            )
        if self.gas_conductivity_W_mK == 0.0 and not any(given):
            raise ValueError("give 'gas_conductivity_W_mK', or both emissivities")
        return self


class JointSection(Section):
    """``[joints.NAME]``: contact elements, surfaces and friction of one joint.

    Properties of one machine have no default: preload, surfaces, friction. A joint without preload
    starts open by ``initial_opening_um``, or by the distance of its sides in the mesh.
    Without ``along`` and ``across``, `meshes.pairing.pair_joint` divides it by its geometry.
    With ``slip_heating`` the friction work heats both sides in equal parts.
    ``tangential_stiffness_ratio`` is Mindlin's 2(1-v)/(2-v), by default for v = 0.27; it is 0.86
    for v = 0.25 and 0.80 for v = 0.33. Side a of a joint on an ``axis`` are the pads, which move
    along side b; ``running_friction_coefficient`` determines the heat of their motion.
    """

    side_a: str | None = None
    side_b: str | None = None
    preload_MPa: NotNegative
    reference_pressure_MPa: Positive | None = None
    initial_opening_um: Finite | Literal["mesh"] | None = None
    along: Count | None = None
    across: Count | None = None
    roughness_um: Positive
    asperity_slope: Positive
    hardness_GPa: Positive
    normal_law: Literal["surface", "back-burdekin"] = "surface"
    back_burdekin: BackBurdekinSection | None = None
    conductance: ConductanceSection = ConductanceSection()
    gap: GapSection | None = None
    friction_coefficient: NotNegative
    slip_heating: bool = False
    tangential_stiffness_ratio: Positive = 0.844
    axis: str | None = None
    running_friction_coefficient: NotNegative = 0.0

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
                "initial_opening_um is negative: the sides would overlap; give 0 or more, or a "
                "preload_MPa"
            )
        return self

    @model_validator(mode="after")
    def _preload_below_hardness(self) -> JointSection:
        if self.preload_MPa >= 500.0 * self.hardness_GPa:
            raise ValueError("preload_MPa must be below half of the hardness")
        if (self.reference_pressure_MPa or 0.0) >= 500.0 * self.hardness_GPa:
            raise ValueError("reference_pressure_MPa must be below half of the hardness")
        if (self.along or 1) * (self.across or 1) > MOST_CONTACTS:
            raise ValueError(
                f"along x across is more than {MOST_CONTACTS} contact elements a patch"
            )
        if (self.side_a is None) != (self.side_b is None):
            raise ValueError("give both side_a and side_b, or neither")
        if self.axis is None and self.running_friction_coefficient > 0.0:
            raise ValueError("'running_friction_coefficient' is for a joint on an axis; add 'axis'")
        if self.axis is not None and self.initial_opening_um == "mesh":
            raise ValueError("initial_opening_um: the distance in the mesh is that at one position")
        if self.normal_law == "back-burdekin" and self.back_burdekin is None:
            raise ValueError(
                'normal_law = "back-burdekin" needs back_burdekin = { coefficient_um = ..., '
                "exponent = ... }"
            )
        return self


class WallSection(Section):
    """``[walls.NAME]``: a rigid body against a surface; one side of a joint.

    Its temperature is that of ``[held_temperatures.NAME]``; without one, no heat passes.
    """

    faces: str
