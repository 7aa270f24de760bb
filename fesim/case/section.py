"""What every section of a case is made of: a strict base, and the numbers that are allowed."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[Finite, Finite, Finite]


#: Unknown keys are errors, nothing changes afterwards.
STRICT = ConfigDict(extra="forbid", frozen=True, strict=False)


class Section(BaseModel):
    """Base of the sections."""

    model_config = STRICT
