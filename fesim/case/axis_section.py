"""Sections of a case for bodies that move during the march, and for the working volume."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Annotated

from pydantic import Field, model_validator

from fesim.case.drive_sections import BallScrewSection, ScaleSection
from thermojoint.artefacts.settings.section import (
    File,
    Finite,
    NotNegative,
    Point,
    Positive,
    Section,
)


class AxisSection(Section):
    """``[axes.NAME]``: bodies that move together along a straight line.

    A body may move along several axes: ``bodies`` includes what the axis carries.

    The position is one value, or a CSV with ``time_s,position_mm``. In the mesh the bodies are at
    ``mesh_position_mm``. Stiffness and heat are exact at positions that are stations apart.
    Without a ball screw or a scale the bodies are at the commanded position; with both, the control
    reads the scale. With ``odometer`` the control counts the travel of the axis, to and fro, and a
    model reads it.
    """

    bodies: Annotated[list[str], Field(min_length=1)]
    direction: Point
    stroke_mm: Annotated[tuple[Finite, Finite], Field(strict=False)]
    mesh_position_mm: Finite = 0.0
    position_mm: Finite | None = None
    file: File | None = None
    station_mm: Positive
    asked_mm: list[Finite] | None = None
    reference_mm: Finite | None = None
    rotation_within_mm: Positive | None = None
    ball_screw: BallScrewSection | None = None
    scale: ScaleSection | None = None
    zero_mm: Finite | None = None
    odometer: bool = False

    @model_validator(mode="after")
    def _one_course(self) -> AxisSection:
        if (self.position_mm is None) == (self.file is None):
            raise ValueError("give either 'position_mm' or 'file', a CSV with time_s,position_mm")
        low, high = self.stroke_mm
        if not low < high:
            raise ValueError(f"stroke_mm: {low:g} to {high:g} is no stroke; lower end first")
        if math.hypot(*self.direction) == 0.0:
            raise ValueError("direction is zero; give the direction of positive motion")
        for name, values in (
            ("position_mm", [] if self.position_mm is None else [self.position_mm]),
            ("asked_mm", self.asked_mm or []),
            ("zero_mm", [] if self.zero_mm is None else [self.zero_mm]),
        ):
            for value in values:
                if not low <= value <= high:
                    raise ValueError(
                        f"{name}: {value:g} mm is outside stroke_mm, {low:g} to {high:g} mm"
                    )
        if self.asked_mm is not None and len(set(self.asked_mm)) < 2:
            raise ValueError("asked_mm: a line needs two positions or more; leave it out")
        return self

    @model_validator(mode="after")
    def _driven(self) -> AxisSection:
        if self.zero_mm is not None and self.ball_screw is None and self.scale is None:
            raise ValueError(
                "zero_mm: without a drive there is no error to set to zero; add [ball_screw] or "
                "[scale], or leave it out"
            )
        if (screw := self.ball_screw) is not None:
            low, high = screw.span_mm()
            half = 0.5 * screw.nut_length_mm
            for end in self.stroke_mm:
                at = end + screw.nut_mm
                if not (low <= at - half and at + half <= high):
                    raise ValueError(
                        f"ball_screw: at {end:g} mm the nut covers {at - half:g} to {at + half:g} "
                        f"mm, but the screw goes from {low:g} to {high:g} mm; correct nut_mm, "
                        "fixed_bearing_mm or far_end_mm"
                    )
        return self


class VolumeSection(Section):
    """``[volume]``: combinations of positions of all axes at which results are requested.

    ``grid_mm`` has positions of each axis, for all their combinations; ``points_mm`` has single
    points with a position of each axis. The temperatures are those at ``at_s``, by default at the
    end.
    """

    grid_mm: dict[str, Annotated[list[Finite], Field(min_length=1)]] | None = None
    points_mm: list[dict[str, Finite]] | None = None
    at_s: Annotated[list[NotNegative], Field(min_length=1)] | None = None

    def places_mm(self, axes: Sequence[str]) -> list[tuple[float, ...]]:
        """Return the points as positions of some axes, those of the grid first."""
        grid = product(*(self.grid_mm[name] for name in axes)) if self.grid_mm else ()
        points = self.points_mm or []
        return [*grid, *(tuple(point[name] for name in axes) for point in points)]


def not_asked(volume: VolumeSection, axes: Mapping[str, AxisSection], end: float) -> str | None:
    """Return why a volume is invalid in a march to `end`, s; None if it is valid."""
    if not volume.grid_mm and not volume.points_mm:
        return "volume: no point; give grid_mm or points_mm"
    named_by = [set(point) for point in volume.points_mm or []]
    for given in [*([set(volume.grid_mm)] if volume.grid_mm else []), *named_by]:
        if given != set(axes):
            named = ", ".join(axes) or "there is none"
            return f"volume: give a position of every axis ({named}) and of no other"
    for place in volume.places_mm(list(axes)):
        for at, (name, axis) in zip(place, axes.items(), strict=True):
            low, high = axis.stroke_mm
            if not low <= at <= high:
                return (
                    f"volume: {name} = {at:g} mm is outside axes.{name}.stroke_mm, {low:g} to "
                    f"{high:g} mm"
                )
    late = [time for time in volume.at_s or [] if time > end]
    return f"volume.at_s: {late[0]:g} s is after the end at {end:g} s" if late else None


def seats_of(axis: AxisSection) -> tuple[str | None, str | None, str | None]:
    """Return the probes at the seats of the near bearing, the far bearing and the scale."""
    near = far = on_scale = None
    if (screw := axis.ball_screw) is not None:
        # Without its own seat the far bearing moves with the near one.
        near, far = screw.seat, screw.far_seat or screw.seat
    if axis.scale is not None:
        on_scale = axis.scale.seat
    return near, far, on_scale
