"""Schema of a file of ranges: the values of a case that a screening varies together."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from fesim.batch.study import RangeSection
from thermojoint.artefacts.settings.section import File, Section


class RangesFile(Section):
    """A whole file of ranges."""

    case: File
    title: str | None = None
    ranges: Annotated[list[RangeSection], Field(min_length=2)]

    @model_validator(mode="after")
    def _each_once(self) -> RangesFile:
        paths = [span.path for span in self.ranges]
        for path in paths:
            if paths.count(path) > 1:
                raise ValueError(f"{path!r} has two ranges; give it one")
        return self
