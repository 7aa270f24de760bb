"""Validation of a learned estimator on an unseen log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.columns import named_in, samples_of
from estimator.interface import follow
from estimator.judging import judge_log
from estimator.learned.estimator import Learned
from estimator.lines import here
from estimator.probe_readings import with_probe_readings
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import Column, fixed_positions, place_of


def run(estimator: Learned, log: Log, every: float | None = None) -> tuple[Array, Array, list[str]]:
    """Return estimate and band, (k, axes) m, and status for every sample of a run.

    With `every` (s) displacements are read at this interval, the first one at the start. Along an
    axis they are those at the position of the log.
    """
    model = estimator.model
    samples = samples_of(model.columns, [log], model.positions)
    if every is not None:
        due = np.arange(log.times[0], log.times[-1] + 1.0, every)
        at = np.minimum(np.searchsorted(log.times, due), len(log.times) - 1)
        readings = np.stack([log.at(name)[at] for name in estimator.axes], axis=1)
        samples = with_probe_readings(samples, log.times[at], readings)
    estimates = [estimate for _, estimate in follow(estimator, samples, estimator.initial_state())]
    displacement, band = here(estimator.axes, estimator.details, estimates)
    return displacement, band, [estimate.status.words for estimate in estimates]


def judged_in(case: str, estimator: Learned, log: Log) -> list[tuple[Log, list[tuple[str, str]]]]:
    """Return logs to judge by, each with displacements of the model and their columns in it.

    In addition to the log itself there is one for each of its columns at a fixed position.

    Raises
    ------
    InputError
        A displacement along an axis is in the log without its position.
    """
    same = named_in(estimator.axes, log)
    judged = [(log, same)] if same else []
    for channel in estimator.model.channels:
        if (slope := channel.slope) is None:
            continue
        if channel.name in dict(same) and place_of(slope.position, log.names) is None:
            raise InputError(
                f"{case}: {channel.name} without {slope.position}, where it was read; record it"
            )
        place = Column(slope.position, slope.position, "m")
        for fixed, at in fixed_positions(log.columns, channel.name):
            values = np.column_stack((log.values, np.full(len(log.times), at)))
            there = replace(log, columns=(*log.columns, place), values=values)
            judged.append((there, [(channel.name, fixed.name)]))
    return judged


def judge(case: str, estimator: Learned, log: Log) -> list[dict[str, str | float]]:
    """Return errors of every displacement of every run, free-running.

    ``rms_error_um`` uses the zero of the learning log; for ``rms_error_zeroed_um`` the estimate at
    the first sample is the day's zero, also for the uncompensated error. Along an axis every
    reading is compared at its position, and so is every column of a fixed one.

    Raises
    ------
    InputError
        None of the model's displacements is in the log, or one along an axis without its position.
    """
    judged = judged_in(case, estimator, log)
    if not judged:
        raise InputError(f"{case}: no column of {', '.join(estimator.axes)} to judge by")
    model = estimator.model
    return judge_log(
        case, estimator, judged, lambda run: samples_of(model.columns, [run], model.positions)
    )
