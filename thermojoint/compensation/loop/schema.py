"""The file of a closed loop: plant, estimator, what acts, what is required; units in the keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from fesim.case.thermal_sections import HeatInput, SampledInput
from thermojoint.artefacts import toml
from thermojoint.compensation.offsets.settings import MOST_STEPS
from thermojoint.compensation.toml_file import validated

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PlantSection(_Section):
    """``[plant]``: the machine, and what drives its sources but the heater."""

    case: Path
    heat_input: HeatInput
    duration_min: Positive
    judged_from_min: NotNegative = 0.0

    @model_validator(mode="after")
    def _judged_within(self) -> PlantSection:
        if self.judged_from_min >= self.duration_min:
            raise ValueError("judged_from_min is not before the end at duration_min")
        return self


class EstimatorSection(_Section):
    """``[estimator]``: a joint-aware model, and what its readings and estimates suffer."""

    model: Path
    noise_pp_K: NotNegative = 0.12
    seed: int = 0
    delay_s: NotNegative = 0.0


class HeaterSection(_Section):
    """``[heater]``: which source is under control, for which axis, against which source."""

    source: str
    axis: str
    against: str
    largest_W: Positive
    resolution_W: NotNegative = 0.0
    setpoint_um: Annotated[float, Field(allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _countable(self) -> HeaterSection:
        steps = self.largest_W / self.resolution_W if self.resolution_W else 1.0
        if not 1.0 <= steps <= MOST_STEPS:
            raise ValueError(
                f"resolution_W must be 0, or largest_W in 1 to {MOST_STEPS:.0e} steps of it"
            )
        return self


class TuningSection(_Section):
    """``[tuning]``: what the tuned loop keeps."""

    gain_margin_dB: Positive = 6.0
    phase_margin_deg: Positive = 45.0
    gain_error: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.3
    delay_error_s: NotNegative = 2.0
    heat_noise: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02


class Loop(_Section):
    """A closed loop as its file says."""

    title: str
    plant: PlantSection
    estimator: EstimatorSection
    heater: HeaterSection | None = None
    tuning: TuningSection = TuningSection()
    offsets: Path | None = None
    tried_delays_s: list[NotNegative] = []

    @model_validator(mode="after")
    def _something_acts(self) -> Loop:
        if self.heater is None and self.offsets is None:
            raise ValueError("nothing acts on the machine: add [heater] or offsets")
        return self


def files_of(loop: Loop) -> list[Path]:
    """Return the files that a loop names, but for those that its machine's case names."""
    history = loop.plant.heat_input
    named = [loop.plant.case, loop.estimator.model, loop.offsets]
    if isinstance(history, SampledInput):
        named.append(history.file)
    return [path for path in named if path is not None]


def read_loop(path: Path | str) -> Loop:
    """Read the file of a closed loop; names of files in it are relative to its folder.

    Parameters
    ----------
    path : Path or str
        TOML.

    Raises
    ------
    InputError
        The file is missing or no TOML, a key is unknown or missing, or a value is out of range.
    """
    path = Path(path)
    data = toml.parse(toml.read_text(path, "loop"), str(path))
    return loop_from_data(data, str(path), path.parent)


def loop_from_data(data: dict[str, Any], where: str, folder: Path) -> Loop:
    """Return a loop given as nested dictionaries; raises as `read_loop`."""
    for place in (
        ("offsets",),
        ("plant", "case"),
        ("plant", "heat_input", "file"),
        ("estimator", "model"),
    ):
        data = _with_file(data, place, folder)
    return validated(Loop, data, where)


def _with_file(data: Any, place: tuple[str, ...], folder: Path) -> Any:  # noqa: ANN401
    """Return data with one name of a file, if it is there, made absolute."""
    if not isinstance(data, dict) or place[0] not in data:
        return data
    given = data[place[0]]
    if len(place) > 1:
        return data | {place[0]: _with_file(given, place[1:], folder)}
    return data | {place[0]: str((folder / given).absolute())} if isinstance(given, str) else data
