"""Sections of a case for the drive of a moving axis: a ball screw, a scale."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from thermojoint.artefacts.settings.section import Finite, Fraction, NotNegative, Positive, Section

#: Parts of a screw that heat the machine.
HEATED = ("nut", "bearing", "far bearing")


class RotatingFilmSection(Section):
    """``[axes.NAME.ball_screw.rotating_film]``: film added by rotation.

    It is ``added_W_m2K`` at ``rotation_rpm``, proportional to rotation to the power ``exponent``.
    """

    added_W_m2K: Positive
    rotation_rpm: Positive
    exponent: Annotated[float, Field(gt=0.0, le=2.0)] = 2.0 / 3.0


class BallScrewSection(Section):
    """``[axes.NAME.ball_screw]``: the screw turned by a motor with a rotary encoder.

    Positions are those of the axis: the fixed bearing is at the motor, the far end has the other
    bearing or none; the middle of the nut is at ``nut_mm`` while the axis is at zero. Frictional
    heat that the screw does not take up enters the structure through the surfaces, if given.
    ``seat`` and ``far_seat`` are probes with which the bearings move.
    """

    nut_surface: str | None = None
    bearing_surface: str | None = None
    far_bearing_surface: str | None = None
    bearings: Literal["fixed-free", "fixed-supported", "fixed-fixed"]
    fixed_bearing_mm: Finite
    far_end_mm: Finite
    nut_mm: Finite = 0.0
    nut_length_mm: Positive
    diameter_mm: Positive
    lead_mm: Positive
    material: str
    film_W_m2K: NotNegative
    rotating_film: RotatingFilmSection | None = None
    bearing_conductance_W_K: NotNegative = 0.0
    nut_torque_Nm: NotNegative = 0.0
    nut_share: Fraction = 1.0
    bearing_torque_Nm: NotNegative = 0.0
    far_bearing_torque_Nm: NotNegative = 0.0
    bearing_share: Fraction = 1.0
    motor_heat_W: NotNegative = 0.0
    stretch_um: Positive | None = None
    pretension_kN: Positive | None = None
    seat: str | None = None
    far_seat: str | None = None
    bearing_stiffness_N_um: Positive | None = None
    far_bearing_stiffness_N_um: Positive | None = None
    cells: Annotated[int, Field(ge=10, le=1000)] = 100

    @model_validator(mode="after")
    def _held_as_it_says(self) -> BallScrewSection:
        if self.fixed_bearing_mm == self.far_end_mm:
            raise ValueError(
                "fixed_bearing_mm and far_end_mm are the same; the screw has no length"
            )
        tension = (self.stretch_um, self.pretension_kN)
        held = {
            "stretch_um": self.stretch_um,
            "pretension_kN": self.pretension_kN,
            "far_seat": self.far_seat,
            "bearing_stiffness_N_um": self.bearing_stiffness_N_um,
            "far_bearing_stiffness_N_um": self.far_bearing_stiffness_N_um,
        }
        if self.bearings == "fixed-fixed":
            if sum(value is not None for value in tension) != 1:
                raise ValueError(
                    "fixed-fixed bearings hold a stretched screw: give either 'stretch_um' or "
                    "'pretension_kN'"
                )
        elif given := [name for name, value in held.items() if value is not None]:
            raise ValueError(
                f"{given[0]}: nothing pulls a {self.bearings} screw; leave it out, or take "
                'bearings = "fixed-fixed"'
            )
        if self.bearings == "fixed-free":
            for name in ("far_bearing_torque_Nm", "far_bearing_surface"):
                if getattr(self, name):
                    raise ValueError(f"{name}: a fixed-free screw has no far bearing; leave it out")
        return self

    def surfaces(self) -> dict[str, str]:
        """Return the heated surfaces by the part they belong to, in the order of the inputs."""
        named = (self.nut_surface, self.bearing_surface, self.far_bearing_surface)
        return {
            part: surface
            for part, surface in zip(HEATED, named, strict=True)
            if surface is not None
        }

    def span_mm(self) -> tuple[float, float]:
        """Return the lower and the upper end of the screw as positions of the axis."""
        low, high = sorted((self.fixed_bearing_mm, self.far_end_mm))
        return low, high


class ScaleSection(Section):
    """``[axes.NAME.scale]``: a linear scale that the control reads.

    It does not move with the axis: at ``fixed_mm`` it is fixed and moves with the probe ``seat``;
    the reading head moves with the axis, and is at ``head_mm`` while the axis is at zero. Its
    temperature follows the ambient, or the probe ``follows``, with a lag.
    """

    expansion_1_K: Finite
    fixed_mm: Finite
    head_mm: Finite = 0.0
    seat: str | None = None
    follows: str | None = None
    lag_s: NotNegative = 0.0
