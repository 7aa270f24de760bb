"""Base class of the sections of settings files; bounded numbers; file names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
#: 0 < x <= 1.
Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1)]

# TOML has arrays instead of tuples; their entries are as strict as the section.
Point = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
Texts = Annotated[tuple[str, ...], Field(strict=False)]


def _beside(path: Path, info: ValidationInfo) -> Path:
    if "\0" in str(path):
        raise ValueError("a null character, which no file name has; correct it")
    # "-" is standard input.
    if info.context is None or str(path) == "-":
        return path
    return (info.context / path).absolute()


#: Name of a file, relative to the settings file; made absolute when the settings are read, because
#: the working folder may change later.
File = Annotated[Path, Field(strict=False), AfterValidator(_beside)]


class Section(BaseModel):
    """Base class of sections: unknown keys and text for numbers are errors, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def files_of(settings: Any) -> list[Path]:  # noqa: ANN401 - sections, lists, values
    """Return all files named in sections, at any depth."""
    if isinstance(settings, Path):
        return [settings]
    if isinstance(settings, BaseModel):
        return files_of(dict(settings))
    if isinstance(settings, dict):
        settings = list(settings.values())
    if isinstance(settings, list | tuple):
        return [path for part in settings for path in files_of(part)]
    return []
