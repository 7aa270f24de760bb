"""Logs, estimates and errors as pandas data frames, by the same rules as files."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
import pandas as pd
import xarray as xr

from calibrate.learning import learn as learning
from calibrate.learning.transfer import learn_like
from estimator import estimate_table
from estimator.intake import axis_name
from estimator.interface import follow
from estimator.judging import judge
from estimator.kind import Cold, OpenedEstimator
from estimator.registry import kind_of
from estimator.rows import figures_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.held_readings import without_repeats
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.quantities import place_of
from thermojoint.artefacts.tables.pieces import pieces_in
from thermojoint.artefacts.units import MEGA
from thermojoint.models.learned import LearnedModel

#: Name of a data frame in error messages.
_FRAME = "data frame"


def log_from_frame(frame: pd.DataFrame, renamed: Mapping[str, str] | None = None) -> Log:
    """Return a data frame as a log, by the rules of a file of the same table.

    Parameters
    ----------
    frame : pandas.DataFrame
        Columns whose names end in their units, and a clock: a column such as ``time_s``, or an
        index of times.
    renamed : mapping, optional
        Name of a column to its new name.

    Raises
    ------
    InputError
        As `read_log`.
    """
    return joined(without_repeats(pieces_in(_lines(frame), _FRAME, renamed)))


def learn(
    data: pd.DataFrame | Log | Path | str | Sequence[Path | str],
    displacements: Sequence[str],
    max_sensors: int = 4,
    kind: learning.Kind = "learned",
    ignored: Sequence[str] = (),
    like: Sequence[LearnedModel] = (),
) -> LearnedModel:
    """Learn a model from the log of a machine.

    Parameters
    ----------
    data : DataFrame, Log, path or sequence of paths
        A log, or the files of one.
    displacements : sequence of str
        Names of the columns to learn, with or without their units.
    max_sensors : int
        Largest number of temperatures used by the model; a baseline uses all.
    kind : str
        ``learned``, or a baseline: ``linear``, ``ridge``, ``arx``.
    ignored : sequence of str
        Columns to ignore.
    like : sequence of LearnedModel
        Models of similar machines, or of this machine before it aged: the log then needs few
        readings of the displacements, and `max_sensors`, `kind` and `ignored` are taken from them.

    Raises
    ------
    InputError
        A column is missing, or the log is not suitable; the message gives the reason.
    """
    names = [displacements] if isinstance(displacements, str) else displacements
    if isinstance(data, pd.DataFrame):
        data = log_from_frame(data)

    def learned(log: Log) -> LearnedModel:
        if like:
            return learn_like([log], names, like)
        return learning.learn([log], names, max_sensors, kind, ignored)

    if isinstance(data, Log):
        return learned(data)
    paths = [Path(data)] if isinstance(data, str | Path) else [Path(path) for path in data]
    return learning.with_origin(learned(read_log(paths)), [path.name for path in paths])


def estimate(
    estimator: OpenedEstimator,
    frame: pd.DataFrame,
    state: Array | None = None,
    cold: float = math.nan,
) -> pd.DataFrame:
    """Estimate the displacement from the readings of a data frame, row by row.

    Parameters
    ----------
    estimator : OpenedEstimator
        `open_estimator`.
    frame : pandas.DataFrame
        The columns that `thermojoint estimate` reads from a file.
    state : ndarray, optional
        Initial state; default: at rest.
    cold : float
        Ambient temperature at the cold start of that state, K, for a joint-aware model; default:
        ambient of the first row. `estimator.states.read_state` returns it for a saved state.

    Returns
    -------
    pandas.DataFrame
        The table of estimates, as `thermojoint estimate` writes it: ``time_s``, details,
        ``NAME_um`` and ``NAME_band_um`` of every axis, ``status`` and ``quality``.

    Raises
    ------
    InputError
        A column is missing, or a row is unusable.
    """
    kind = kind_of(estimator)
    pieces = pieces_in(_lines(frame), _FRAME, kind.renamed(estimator.model))
    samples = kind.log(estimator.model, pieces, _FRAME, None, Cold(cold))
    start = estimator.initial_state() if state is None else state
    text = io.StringIO()
    text.write(",".join(estimate_table.header(estimator)) + "\n")
    for _, sample in follow(estimator, samples, start):
        cells = estimate_table.row(estimator, sample)
        text.write(",".join(f'"{cell}"' if "," in cell else cell for cell in cells) + "\n")
    text.seek(0)
    return pd.read_csv(text)


def validate(
    estimator: OpenedEstimator, data: pd.DataFrame | xr.Dataset | Mapping[str, xr.Dataset]
) -> pd.DataFrame:
    """Validate an estimator, free-running from rest, by displacements that it does not read.

    Parameters
    ----------
    estimator : OpenedEstimator
        `open_estimator`.
    data : DataFrame, Dataset or mapping
        A log with the displacements as columns named like the estimator's axes; or a response, or
        several by name.

    Returns
    -------
    pandas.DataFrame
        A row for every case and axis: ``case``, ``estimator``, ``axis``, ``peak_total_um``,
        ``max_abs_error_um``, ``rms_error_um``, and for an estimator with a band ``mean_band_um``,
        ``band_cover`` and ``interval_score_um``.

    Raises
    ------
    InputError
        A displacement, or a reading of the estimator, is missing.
    """
    if isinstance(data, pd.DataFrame):
        return _judged_by_frame(estimator, data)
    cases = {"response": data} if isinstance(data, xr.Dataset) else data
    kind = kind_of(estimator)
    rows: list[dict[str, str | float]] = []
    for name, response in cases.items():
        samples = kind.response(estimator.model, response)
        rows += judge(name, response, estimator, samples)
    return pd.DataFrame(rows)


def samples(
    estimator: OpenedEstimator, rows: Iterable[Mapping[str, float]], cold: float = math.nan
) -> Iterator[tuple[float, ...]]:
    """Yield samples for `follow` from readings by name, each in the unit of its name.

    Parameters
    ----------
    estimator : OpenedEstimator
        `open_estimator`.
    rows : iterable of mapping
        ``time_s`` and the names of `reads`, or the same quantities in another unit, e.g.
        ``spindle_rad_s`` for ``spindle_rpm``. Absent names are missing readings.
    cold : float
        Temperature of the cold machine, in the unit of its readings; default: from the first
        readings.

    Raises
    ------
    InputError
        A row has no time, or an unknown reading.
    """
    intake = kind_of(estimator).intake(estimator.model, False)
    for row in rows:
        if "time_s" not in row:
            raise InputError("sample: no 'time_s'; every row needs it")
        given = {name: value for name, value in row.items() if name != "time_s"}
        readings = np.full(len(intake.names), math.nan)
        for k, name in enumerate(intake.names):
            place = place_of(name, list(given))
            if place is not None:
                cell = np.array([given.pop(list(given)[place.at])], dtype=float)
                readings[k] = place.values(cell)[0]
        if given:
            raise unknown_name("reading", next(iter(given)), intake.names, "sample")
        values, cold = intake.convert(intake.usable(readings.tolist()), cold)
        yield (float(row["time_s"]), *values)


def reads(estimator: OpenedEstimator) -> tuple[str, ...]:
    """Return the names of an estimator's readings in every sample, each ending in its unit.

    Parameters
    ----------
    estimator : OpenedEstimator
        `open_estimator`.
    """
    intake = kind_of(estimator).intake(estimator.model, False)
    return intake.names[: intake.wanted]


def _judged_by_frame(estimator: OpenedEstimator, frame: pd.DataFrame) -> pd.DataFrame:
    log = log_from_frame(frame)
    axes = [axis_name(axis) for axis in estimator.axes]
    truth = MEGA * np.array([log.at(axis) for axis in axes]).T
    estimates = estimate(estimator, frame)
    if len(estimates) != len(truth):
        raise InputError(
            f"{_FRAME}: {len(estimates)} estimates of {len(truth)} rows; drop the others"
        )
    values, bands = (
        estimates[[f"{axis}{ending}" for axis in axes]].to_numpy(dtype=float)
        for ending in ("_um", "_band_um")
    )
    counted = np.isfinite(truth).all(axis=1)
    if not counted.any():
        raise InputError(f"{_FRAME}: no row with every displacement ({', '.join(axes)})")
    known = None if np.isnan(bands).all() else bands[counted] / MEGA
    error = (values - truth)[counted] / MEGA
    figures = {"peak_total_um": np.abs(truth[counted]).max(axis=0)} | figures_of(error, known)
    return pd.DataFrame(
        {"case": "log", "estimator": estimator.kind, "axis": axis}
        | {name: float(of[k]) for name, of in figures.items()}
        for k, axis in enumerate(axes)
    )


def _lines(frame: pd.DataFrame) -> TextIO:
    """Return a data frame as the lines of a CSV; an index of times is its clock."""
    timed = isinstance(frame.index, pd.DatetimeIndex)
    if timed:
        clock = pd.Series(frame.index, name="time").map(pd.Timestamp.isoformat)
        frame = frame.reset_index(drop=True)
        frame.insert(0, "time", clock)
    elif frame.index.name is not None:
        frame = frame.reset_index()
    text = io.StringIO()
    frame.to_csv(text, index=False)
    text.seek(0)
    return text
