"""Learned model: displacement as a bounded linear filter of measured inputs.

    δ_c = zero_c + Σ_f w_cf φ_f,   φ_f = relaxation with τ_f of u_f,

u_f is a temperature above its reference, or the heat |x / scale|^p of a speed, power or load. The
covariance of the weights includes the uncertainty due to the log and to the choice of features, so
that the band is wider outside the log's range. `calibrate.learning` fits it, `estimator.learned`
runs it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import NonNegativeFloat, PositiveFloat, TypeAdapter

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.json_file import JsonKind, read_json, validated, write_json
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.filters.relaxations import relax_all
from thermojoint.models.parameters import STRICT

#: Possible temperatures of a machine tool, K.
POSSIBLE = (200.0, 600.0)
#: Limit on readings of other quantities, SI.
LARGEST = 1e30

FILE = JsonKind(
    "thermojoint-learned-model", 1, "model", "written by 'thermojoint learn'", "learn again"
)

#: Name of the mean displacement in the comparison of kinds of models.
MEAN = "mean"
#: Name of the given model, unchanged but for a zero from this log, in the same comparison.
SISTER = "sister"
#: A kind is preferred to the requested one if its error is below this fraction of the other's.
_BETTER = 0.9
#: Errors below this are measurement noise and count as equal, µm.
_NOISE = 0.1


@dataclass(frozen=True)
class Feature:
    """Input of a weight."""

    __pydantic_config__ = STRICT

    #: Column of the log, with its unit.
    column: str
    #: Time constant of the relaxation, s; 0 for the unfiltered signal.
    tau_s: NonNegativeFloat
    #: p of a heat; 0 for a temperature.
    exponent: NonNegativeFloat = 0.0
    #: Reference of a temperature rise, K.
    reference: float = 0.0
    #: Reference of a speed or power, SI.
    scale: PositiveFloat = 1.0


@dataclass(frozen=True)
class LearnedSlope:
    """Change of a displacement with the position of an axis: slope = zero + Σ_f v_f φ_f."""

    __pydantic_config__ = STRICT

    #: Column of the position, with its unit.
    position: str
    #: P0, m, where the displacement equals that of the channel, K0.
    reference: float
    #: Smallest and largest position that was read, m.
    stroke: tuple[float, float]
    #: Slope with all features zero, m/m.
    zero: float
    #: Weight of each feature, m/m.
    weights: tuple[float, ...]
    #: Standard deviation of the unexplained slope, m/m.
    drift: PositiveFloat


@dataclass(frozen=True)
class LearnedChannel:
    """One displacement; with a slope, the displacement at the reference position."""

    __pydantic_config__ = STRICT

    #: Column of the log, with its unit.
    name: str
    #: Displacement with all features zero, m, relative to the zero of the learning log.
    zero: float
    #: Weight of each feature, m.
    weights: tuple[float, ...]
    #: Covariance of the weights, m2; with a slope, of (weights, its zero, its weights).
    covariance: tuple[tuple[float, ...], ...]
    #: Standard deviation of the unexplained displacement, m: the error on held-out blocks.
    drift: PositiveFloat
    #: Smallest and largest displacement of the log, m.
    span: tuple[float, float]
    #: Factor on the band so that it covers the held-out blocks.
    widening: PositiveFloat = 1.0
    #: Slope, if the displacement was read at several positions of an axis.
    slope: LearnedSlope | None = None


@dataclass(frozen=True)
class LearnedFrom:
    """Provenance of a model, and its error compared with others."""

    __pydantic_config__ = STRICT

    #: Number of samples of the log.
    samples: int = 0
    #: Names of its files.
    files: tuple[str, ...] = ()
    #: Faults of sensors, and their treatment.
    faults: tuple[str, ...] = ()
    #: Limitations of the log.
    warnings: tuple[str, ...] = ()
    #: Kind of model to the rms error of each displacement on all held-out blocks, and on the worst
    #: one, µm; `MEAN` is the mean displacement without a model, `SISTER` an unchanged given model.
    errors_um: dict[str, tuple[float, ...]] = field(default_factory=dict)
    worst_um: dict[str, tuple[float, ...]] = field(default_factory=dict)
    #: Package to version.
    versions: dict[str, str] = field(default_factory=dict)

    def best(self, own: str) -> str:
        """Return the kind to use: `own` unless another is better on every displacement.

        Kinds are compared by the error on the worst held-out block. A kind that is better on some
        displacements only may be so by chance.
        """
        if own not in self.worst_um:
            return own
        ratios = {
            name: max(
                max(a, _NOISE) / max(b, _NOISE)
                for a, b in zip(worst, self.worst_um[own], strict=True)
            )
            for name, worst in self.worst_um.items()
            if name not in (MEAN, SISTER, own)
        }
        least = min(ratios, key=lambda name: ratios[name], default=own)
        return least if ratios.get(least, 1.0) < _BETTER else own


@dataclass(frozen=True)
class LogEnd:
    """State at the end of the log: a log that continues its clock starts from this state."""

    __pydantic_config__ = STRICT

    #: Time on the log's clock, s.
    time_s: float
    #: Value of each column of the model, SI.
    values: tuple[float, ...]
    #: Relaxation of each feature.
    relaxations: tuple[float, ...]


@dataclass(frozen=True, repr=False)
class LearnedModel(Described):
    """A learned model.

    Attributes
    ----------
    kind : str
        ``learned``, or a baseline: ``linear``, ``ridge``, ``arx``.
    features : tuple of Feature
        Inputs.
    channels : tuple of LearnedChannel
        Estimated displacements.
    spans : dict
        Column to its smallest and largest value in the log, SI.
    duration_s : float
        Duration of the longest run, s.
    learned_from : LearnedFrom
        Provenance.
    renamed : dict
        Name of a column in the log to its name in the model.
    log_end : LogEnd, optional
        State at the end of the log.
    """

    __pydantic_config__ = STRICT

    kind: str
    features: tuple[Feature, ...]
    channels: tuple[LearnedChannel, ...]
    spans: dict[str, tuple[float, float]]
    duration_s: PositiveFloat
    learned_from: LearnedFrom = field(default_factory=LearnedFrom)
    renamed: dict[str, str] = field(default_factory=dict)
    log_end: LogEnd | None = None

    def _facts(self) -> dict[str, str]:
        return {
            "kind": self.kind,
            "estimates": ", ".join(channel.name for channel in self.channels),
            "reads": ", ".join(self.columns),
            "learned from": ", ".join(self.learned_from.files) or "a log in memory",
        }

    def renamed_in(self, columns: Sequence[str]) -> dict[str, str]:
        """Return the new names of columns for reading a log like the learning log.

        Parameters
        ----------
        columns : sequence of str
            Required columns; the clock is always included.
        """
        return {
            theirs: ours for theirs, ours in self.renamed.items() if ours in (*columns, "time_s")
        }

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Required columns of a log, in the order of their first features."""
        return tuple(dict.fromkeys(feature.column for feature in self.features))

    @cached_property
    def positions(self) -> tuple[str, ...]:
        """Columns of positions that the slopes refer to."""
        slopes = (channel.slope for channel in self.channels)
        return tuple(dict.fromkeys(slope.position for slope in slopes if slope))

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """Temperatures among the columns."""
        heats = {feature.column for feature in self.features if feature.exponent}
        return tuple(name for name in self.columns if name not in heats)

    @cached_property
    def possible(self) -> tuple[tuple[float, float], ...]:
        """Limits of each column's readings, SI; readings beyond them are missing."""
        known = [column_named(name) for name in self.columns]
        return tuple(
            POSSIBLE
            if column and column.quantity == "temperature" and column.unit != "K"
            else (-LARGEST, LARGEST)
            for column in known
        )

    @cached_property
    def taus(self) -> Array:
        """Time constant of each feature, s."""
        return np.array([feature.tau_s for feature in self.features])

    @cached_property
    def heats(self) -> Flags:
        """Whether each feature is a heat."""
        return np.array([feature.exponent > 0.0 for feature in self.features], dtype=bool)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Index of the column of each feature."""
        return self._inputs.places

    @cached_property
    def signal_ranges(self) -> Array:
        """Width of the range of each feature's signal in the log; for a heat, from zero."""
        low, high = self.signals(np.array([self.spans[name] for name in self.columns]).T)
        return np.where(self.heats, np.maximum(low, high), high - low)

    @cached_property
    def _inputs(self) -> _Inputs:
        return _inputs_of(self.features, self.columns)

    def signals(self, values: Array) -> Array:
        """Return the signal of each feature, shape (..., n).

        Parameters
        ----------
        values : ndarray, shape (..., columns)
            SI.
        """
        return _signals(self._inputs, values)

    @cached_property
    def digest(self) -> str:
        """Fingerprint of the model."""
        content = _MODEL.dump_python(self, mode="json")
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


_MODEL: TypeAdapter[LearnedModel] = TypeAdapter(LearnedModel)


class _Inputs(NamedTuple):
    """What turns the columns into the signals of n features; arrays of shape (n,)."""

    #: Index of the column.
    places: NDArray[np.int64]
    #: As in `Feature`.
    exponents: Array
    references: Array
    scales: Array


def _inputs_of(features: Sequence[Feature], columns: Sequence[str]) -> _Inputs:
    return _Inputs(
        np.array([columns.index(feature.column) for feature in features]),
        np.array([feature.exponent for feature in features]),
        np.array([feature.reference for feature in features]),
        np.array([feature.scale for feature in features]),
    )


def _signals(inputs: _Inputs, values: Array) -> Array:
    own = values[..., inputs.places]
    heats = np.abs(own / inputs.scales) ** inputs.exponents
    return np.where(inputs.exponents > 0.0, heats, own - inputs.references)


def at_rest(features: Sequence[Feature], first: Array) -> Array:
    """Return relaxations at the start of a run with an unknown past, shape (n,).

    Temperatures are assumed constant before, and no heat was supplied.
    """
    heats = [feature.exponent > 0.0 for feature in features]
    return np.where(heats, 0.0, first)


def features_of(
    features: Sequence[Feature], columns: Sequence[str], run: tuple[Array, Array]
) -> Array:
    """Return the features of one run, shape (k, features); `run` is times and values in SI."""
    times, values = run
    inputs = _signals(_inputs_of(features, columns), values)
    taus = np.array([feature.tau_s for feature in features])
    return relax_all(times, inputs, taus, at_rest(features, inputs[0]))


def write_learned(model: LearnedModel, path: Path | str) -> None:
    """Write a learned model, whole or not at all.

    Parameters
    ----------
    model : LearnedModel
        Result of `learn`.
    path : Path or str
        JSON to write.

    Raises
    ------
    InputError
        A value is not finite.
    """
    content = FILE.header | _MODEL.dump_python(model, mode="json")
    try:
        write_json(path, content, indent=1)
    except ValueError as error:
        raise InputError(f"{path}: the model has a value that is not finite") from error


def read_learned(path: Path | str) -> LearnedModel:
    """Read a learned model.

    Parameters
    ----------
    path : Path or str
        JSON written by `write_learned`.

    Raises
    ------
    InputError
        The file is missing, truncated, of another kind or version, or its parts do not match.
    """
    content = read_json(path, FILE)
    model = validated(_MODEL, content, str(path), FILE.remedy)
    count = len(model.features)
    for channel in model.channels:
        slope = channel.slope
        size = 2 * count + 1 if slope else count
        shape = {len(channel.covariance), *map(len, channel.covariance)}
        weights = {len(channel.weights), len(slope.weights) if slope else count}
        if shape != {size} or weights != {count}:
            raise InputError(f"{path}: {channel.name}: {count} weights and their covariance needed")
    missing = set(model.columns) - set(model.spans)
    end = model.log_end
    if end and (len(end.values), len(end.relaxations)) != (len(model.columns), count):
        raise InputError(f"{path}: log_end: a value for each column and feature needed")
    if missing or not model.channels:
        raise InputError(f"{path}: spans or channels are missing; learn again")
    return model
