"""Baselines: regressions from temperatures to displacement, without physics of the machine.

Channels are the rises of the sensors a, b, T1 and T2 above the current ambient, K. No regression
has a constant term: a machine at rest has no displacement. `calibrate.baselines` fits them,
`estimator.baselines` runs them, and this module stores them as JSON.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import PositiveFloat, TypeAdapter

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.json_file import JsonKind, read_json, validated, write_json
from thermojoint.models.parameters import STRICT, Span
from thermojoint.models.sensors import ROLES

FILE = JsonKind(
    "thermojoint-baselines",
    1,
    "file of baselines",
    "written by 'thermojoint calibrate --baselines'",
    "calibrate again",
)


@dataclass(frozen=True)
class Regression:
    """δ as a weighted sum of temperatures and of their low-passes."""

    __pydantic_config__ = STRICT

    #: τ of each low-pass 1/(1 + τ s), s; none for a regression on the temperatures alone.
    time_constants: tuple[PositiveFloat, ...]
    #: Axis to the weight of every feature, m/K: the channels, then the channels through the first
    #: low-pass, and so on.
    weights: dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class Autoregression:
    """ARX: δ_k = Σ_i a_i δ_{k-i} + Σ_j b_j · T_{k-j}, run on its own past estimates."""

    __pydantic_config__ = STRICT

    #: a_1, a_2 ...; every root of z^n - Σ a_i z^(n-i) lies inside the unit circle.
    past: tuple[float, ...]
    #: b_0, b_1 ..., each with a weight per channel, m/K.
    inputs: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Baselines:
    """All regressions of one calibration."""

    __pydantic_config__ = STRICT

    #: Multiple linear regression on the current temperatures.
    mlr: Regression
    #: Ridge regression on the temperatures and their low-passes.
    ridge: Regression
    #: Axis to its autoregression.
    arx: dict[str, Autoregression]
    #: Step of the autoregressions, s.
    interval_s: PositiveFloat
    #: Calibrated ranges, by channel.
    span: Span

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return tuple(self.arx)


_BASELINES: TypeAdapter[Baselines] = TypeAdapter(Baselines)


def write_baselines(baselines: Baselines, path: Path) -> None:
    """Write baselines to `path` (JSON), whole or not at all."""
    write_json(path, FILE.header | _BASELINES.dump_python(baselines, mode="json"))


def read_baselines(path: Path) -> Baselines:
    """Read baselines written by `write_baselines`.

    Raises
    ------
    InputError
        The file is missing, truncated, of another kind or version, or its parts do not match.
    """
    content = read_json(path, FILE)
    baselines = validated(_BASELINES, content, str(path), FILE.remedy)
    channels = len(ROLES)
    sizes = [
        (len(weights), channels * (1 + len(regression.time_constants)))
        for regression in (baselines.mlr, baselines.ridge)
        for weights in regression.weights.values()
    ] + [(len(row), channels) for regression in baselines.arx.values() for row in regression.inputs]
    same = all(
        set(regression.weights) == set(baselines.arx)
        for regression in (baselines.mlr, baselines.ridge)
    )
    if not same or any(given != wanted for given, wanted in sizes):
        raise InputError(f"{path}: axes or numbers of weights do not fit together; {FILE.remedy}")
    if set(baselines.span.temperatures) != set(ROLES):
        raise InputError(f"{path}: span.temperatures: give {', '.join(ROLES)}; {FILE.remedy}")
    return baselines


def taus_of(time_constants: Sequence[float], channels: int) -> Array:
    """Return the time constant of every feature, s: 0 for the channels, then those of low-passes.

    The order is that of `thermojoint.models.filters.relaxations`.
    """
    return np.repeat(np.array([0.0, *time_constants]), channels)
