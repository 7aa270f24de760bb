"""Kinds of estimators, as commands, the service and exporters see them.

A kind is a folder beside `estimator.fchs` with one `Kind`, and one line in `estimator.registry`; or
the same in another distribution, named by an entry point. The defaults fit the simplest kind: the
file contains the complete estimator, the model is the estimator, and a sample consists of the
readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np

from estimator.columns import Sample, named_in, samples_of
from estimator.intake import Intake, by_channels
from estimator.interface import READING_NOISE, Estimator, NextReading, follow
from estimator.judging import Conditions, Figures, JudgedIn, judge_responses
from estimator.lines import Stroke
from estimator.ranges import Range
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.units import MEGA

if TYPE_CHECKING:
    import xarray as xr

    from estimator.export.program import Contents, Precision

#: Called with the first row of a log as read: column to value.
OnFirst = Callable[[Mapping[str, float]], None]


@dataclass
class Cold:
    """Ambient at which a machine was cold, K, for kinds with temperatures relative to it.

    A log in °C sets it by its first row; a run that is continued keeps that of its beginning.
    """

    #: NaN before it is known; 0 where temperatures are relative to it.
    value: float = math.nan
    #: Whether the run continues from a state.
    continued: bool = False


class OpenedEstimator(Estimator, Protocol):
    """Estimator opened from a file."""

    @property
    def schema(self) -> str:
        """Schema of the model file, which identifies the kind in the registry."""
        ...

    @property
    def model(self) -> Any:  # noqa: ANN401
        """Content of the model file, as its `Kind` takes it."""
        ...


@dataclass(frozen=True)
class Options:
    """Options for starting an estimator; a kind declares which of the last three it takes."""

    #: Nominal sampling interval and length of a run, s, for estimators assembled for them.
    interval: float = 2.0
    run_length: float = 7200.0
    #: Standard deviation of a displacement reading, m; default `READING_NOISE`.
    reading_noise: float | None = None
    #: Parameters of the machine that are learned online.
    ageing: tuple[str, ...] = ()
    #: Regression to use from a file of baselines; default ``ridge``.
    regression: str | None = None

    @property
    def noise(self) -> float:
        """Standard deviation of a displacement reading, m."""
        return READING_NOISE if self.reading_noise is None else self.reading_noise


M = TypeVar("M")
E = TypeVar("E", bound=OpenedEstimator)


def _itself(model: Any, options: Options) -> Any:  # noqa: ANN401
    return model


def _intake(model: Any, above_ambient: bool) -> Intake:  # noqa: ANN401
    if above_ambient:
        raise InputError(f'reads = "above-ambient": not for {model.kind}; leave the key out')
    return by_channels(model.channels)


def _log(
    model: Any,  # noqa: ANN401
    pieces: Iterable[Log],
    where: str,
    on_first: OnFirst | None,
    cold: Cold,
) -> Iterator[Sample]:
    wanted = by_channels(model.channels)
    return samples_of(wanted.names[: wanted.wanted], pieces)


def _sensors(model: Any, response: xr.Dataset) -> Sequence[str]:  # noqa: ANN401
    return [channel.name for channel in model.channels if channel.unit == "K"]


def _response(model: Any, response: xr.Dataset) -> Iterator[Sample]:  # noqa: ANN401
    from thermojoint.artefacts.response import columns_of

    values = columns_of(response, "temperature", _sensors(model, response))
    for time, row in zip(response["time"].to_numpy().tolist(), values.tolist(), strict=True):
        yield (time, *row)


def followed(estimator: Estimator, samples: Iterable[Sample], state: Array) -> tuple[Array, Array]:
    """Return displacements and half-widths of their bands, (n, axes), m, sample by sample."""
    run = [estimate for _, estimate in follow(estimator, samples, state)]
    return np.array([one.displacement for one in run]), np.array([one.band for one in run])


def _judged(
    kind: Kind[Any, Any],
    model: Any,  # noqa: ANN401
    responses: Mapping[str, xr.Dataset],
    conditions: Conditions,
) -> Figures:
    conditions.only_noise(kind.name)
    estimator = kind.start(model, Options())
    return judge_responses(
        [estimator],
        responses,
        lambda response: list(kind.response(model, response)),
        lambda response: kind.sensors(model, response),
        conditions,
    )


def judged_from_rest(case: str, estimator: OpenedEstimator, log: Log) -> JudgedIn:
    """Return a log whose displacements are zero where each run is read first, and their columns.

    Raises
    ------
    InputError
        None of the estimator's displacements is in the log.
    """
    names = [f"{axis}_um" for axis in estimator.axes]
    same = dict(zip(names, estimator.axes, strict=True))
    pairs = [(same[name], column) for name, column in named_in(names, log)]
    if not pairs:
        raise InputError(f"{case}: no column of {', '.join(names)} to judge by")
    values = log.values.copy()
    for k in (log.index(column) for _, column in pairs):
        for first, end in pairwise((*log.starts, len(log.times))):
            read = np.flatnonzero(np.isfinite(values[first:end, k]))
            if read.size:
                values[first:end, k] -= values[first + read[0], k]
    return [(replace(log, values=values), pairs)]


@dataclass(frozen=True)
class Kind(Generic[M, E]):
    """Definition of a kind of estimator."""

    #: Its name with an article, for messages: ``a learned model``.
    name: str
    #: Path to the content of the file; raises `InputError`.
    read: Callable[[Path], M]
    #: Model to a unique text; a state can only be resumed with the same one.
    fingerprint: Callable[[M], str]
    #: (model, options) to the estimator.
    start: Callable[[M, Options], E] = _itself
    #: Which of ``reading_noise``, ``ageing``, ``regression`` it takes.
    options: frozenset[str] = frozenset()
    #: Whether the estimator is assembled for a nominal sampling interval.
    paced: bool = False
    #: Estimator to the sampling interval and the length of a run that it is assembled for, s; None
    #: if a run that is continued may have others.
    assembled_for: Callable[[E], tuple[float, float]] | None = None
    #: Model to whether it is assembled already, and takes no other interval.
    assembled: Callable[[M], bool] = lambda model: False
    #: Estimator to its state for a machine with an unknown past.
    warm_state: Callable[[E], Array] | None = None
    #: Estimator to additional JSON data stored with its states; (model, options, that data, name of
    #: the file) to the resumed estimator.
    carried: Callable[[E], Any] | None = None
    resumed: Callable[[M, Options, Any, str], E] | None = None
    #: (model, whether temperatures are above the ambient) to the readings of a machine.
    intake: Callable[[M, bool], Intake] = _intake
    #: Model to the names that it expects of a log's columns, in the form that
    #: `thermojoint.artefacts.log_file.read_log` takes.
    renamed: Callable[[M], Mapping[str, str]] = lambda model: {}
    #: (model, a log in pieces, its name, callback for the first row, ambient of the cold machine)
    #: to samples.
    log: Callable[[M, Iterable[Log], str, OnFirst | None, Cold], Iterator[Sample]] = _log
    #: (model, response) to samples, and to the names of their probes.
    response: Callable[[M, xr.Dataset], Iterator[Sample]] = _response
    sensors: Callable[[M, xr.Dataset], Sequence[str]] = _sensors
    #: (estimator, samples, state before them) to displacements and half-widths of their bands.
    run: Callable[[E, Iterable[Sample], Array], tuple[Array, Array]] = followed
    #: Model to its calibrated ranges.
    ranges: Callable[[M], tuple[Range, ...]] = lambda model: ()
    #: Model to the strokes of its displacements along an axis, by their names without units; the
    #: details of its estimates have their lines (`estimator.lines`).
    strokes: Callable[[M], Mapping[str, Stroke]] = lambda model: {}
    #: (kind, model, name to response, conditions) to errors; None for a kind judged by logs only.
    judge: Callable[[Kind[M, E], M, Mapping[str, xr.Dataset], Conditions], Figures] | None = _judged
    #: (model, name to log) to errors; None for a kind judged by responses only.
    judge_logs: Callable[[M, Mapping[str, Log]], Figures] | None = None
    #: (name of a log, estimator, log) to the logs and columns that it is judged by.
    judged_in: Callable[[str, E, Log], JudgedIn] = judged_from_rest
    #: (estimator, state, sample as `channels`) to reading minus model, NaN where missing.
    residuals: Callable[[E, Array, Array], Array] | None = None
    #: (estimator, state, largest half-band m) to the displacement reading to take, or None.
    next_reading: Callable[[E, Array, float], NextReading | None] | None = None
    #: Estimator to the half-band after a displacement reading, m: no limit can be smaller.
    narrowest_band: Callable[[E], float] | None = None
    #: (estimator, precision, nominal interval s) to the contents of an exported program.
    program: Callable[[E, Precision, float], Contents] | None = None


def checked_limit(
    kind: Kind[Any, Any],
    estimator: OpenedEstimator,
    limit: float,
    where: str,
) -> None:
    """Refuse a limit of the band (m) that displacement readings cannot keep.

    Raises
    ------
    InputError
        The kind requests no readings, or the limit is below the band after a reading.
    """
    if kind.next_reading is None or kind.narrowest_band is None:
        raise InputError(f"{where}: {kind.name} asks for no readings; leave it out")
    least = kind.narrowest_band(estimator)
    if limit <= least:
        raise InputError(
            f"{where}: {MEGA * limit:g} um is below the {MEGA * least:.2g} um of the band after a "
            "reading of the displacement; make it larger"
        )
