"""Sections of a case for bolts."""

from __future__ import annotations

from pydantic import model_validator

from thermojoint.artefacts.settings.section import File, Point, Positive, Section


class BoltEndSection(Section):
    """``[bolts.NAME.head]`` and ``thread``: a surface, or a disc around a point of a body.

    The disc is perpendicular to the bolt; any part of it outside all cells, such as in a hole, is
    left out.
    """

    surface: str | None = None
    position_mm: Point | None = None
    diameter_mm: Positive | None = None
    body: str | None = None

    @model_validator(mode="after")
    def _one_place(self) -> BoltEndSection:
        if (self.surface is None) == (self.position_mm is None):
            raise ValueError("give either 'surface' or 'position_mm'")
        disc = self.diameter_mm is not None, self.body is not None
        if (self.position_mm is not None) != all(disc) or any(disc) != all(disc):
            raise ValueError("'diameter_mm' and 'body' go with 'position_mm', both of them")
        return self


class BoltSection(Section):
    """``[bolts.NAME]``: a bolt of the meshed part, tightened to ``force_kN`` before any load.

    Its stiffness follows from ``diameter_mm``, its length and its material's modulus, or is
    ``stiffness_N_um``; it expands like its material. ``file`` is a CSV with ``time_s,factor``: the
    force with unmoved ends, relative to ``force_kN``.
    """

    head: BoltEndSection
    thread: BoltEndSection
    force_kN: Positive
    material: str
    diameter_mm: Positive | None = None
    stiffness_N_um: Positive | None = None
    clamped_length_mm: Positive | None = None
    file: File | None = None

    @model_validator(mode="after")
    def _one_stiffness(self) -> BoltSection:
        if (self.diameter_mm is None) == (self.stiffness_N_um is None):
            raise ValueError("give either 'diameter_mm' or 'stiffness_N_um'")
        return self
