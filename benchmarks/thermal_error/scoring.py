"""The score of a method: free-running errors on runs it has not seen."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.thermal_error.tasks import Task, actual, as_given
from estimator.rows import interval_score
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log

#: Column of displacement to what is predicted, m, shape (k,); or (k, 2), where the second column
#: is half of the width in which the displacement lies with 95 %.
Predictions = Mapping[str, Array]
#: From a training log and a test log without displacement, or with a few readings of it.
Method = Callable[[Log, Log], Predictions]

#: Two predictions of one moment may differ by this, m.
SAME = 1e-9
#: A method is run again on this part of the test, and on what precedes every reading of the
#: displacement, to see that it does not look ahead.
HEARD = 0.5


class NotApplicable(InputError):
    """The method needs what this log does not have."""


@dataclass(frozen=True)
class Score:
    """Of one method on one channel of one task."""

    task: str
    method: str
    channel: str
    #: Of the error, µm.
    rms_um: float
    max_um: float
    #: 1 - rms of the error / rms of the displacement itself.
    removed: float
    #: Part of the samples inside the band, where the method gives one.
    cover: float | None
    #: `estimator.rows.interval_score` of the band, µm.
    interval_score_um: float | None
    #: Of the processor: learning, if no task before had the same training, and predicting.
    seconds: float


def score(task: Task, name: str, method: Method) -> list[Score]:
    """Run a method on a task and judge it.

    Parameters
    ----------
    task : Task
    name : str
        Of the method.
    method : callable

    Raises
    ------
    InputError
        The method fails; or its predictions lack a channel, have another shape, are not finite,
        have a negative band or change if the future is withheld.
    NotApplicable
        The method cannot learn from this log.
    """
    test = as_given(task)
    begun = time.process_time()
    predicted = _predicted(task, name, method, test)
    taken = time.process_time() - begun
    cuts = (round(HEARD * len(test.times)), *(at for at in task.read if at))
    again = {cut: _predicted(task, name, method, test.part(slice(0, cut))) for cut in cuts}
    late = test.times >= test.times[0] + task.settled
    found = []
    for channel, true in actual(task).items():
        claim, band = _checked(predicted, channel, len(test.times), name)
        for cut, short in again.items():
            past, _ = _checked(short, channel, cut, name)
            if np.abs(past - claim[:cut]).max() > SAME:
                raise InputError(
                    f"{name}: {channel} changes if the future is withheld; look back only"
                )
        there = np.isfinite(true) & late
        error = np.abs(claim - true)[there]
        still = float(np.sqrt(np.mean(true[there] ** 2)))
        rms = float(np.sqrt(np.mean(error**2)))
        within = None if band is None else band[there]
        found.append(
            Score(
                task=task.name,
                method=name,
                channel=channel,
                rms_um=1e6 * rms,
                max_um=1e6 * float(error.max()),
                removed=1.0 - rms / still,
                cover=None if within is None else float(np.mean(error <= within)),
                interval_score_um=None
                if within is None
                else 1e6 * float(interval_score(error, within)),
                seconds=taken,
            )
        )
    return found


def _predicted(task: Task, name: str, method: Method, test: Log) -> Predictions:
    """Return what a method predicts from logs that it cannot change for the methods after it."""
    for log in (task.training, test):
        log.times.setflags(write=False)
        log.values.setflags(write=False)
    try:
        predicted = method(task.training, test)
    except InputError:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        raise InputError(
            f"{name}: {task.name}: {type(error).__name__}, {error} "
            f"({Path(at.filename).name}:{at.lineno})"
        ) from error
    if not isinstance(predicted, Mapping):
        raise InputError(
            f"{name}: returned a {type(predicted).__name__}; return a column for every length"
        )
    return predicted


def _checked(
    predicted: Predictions, channel: str, count: int, name: str
) -> tuple[Array, Array | None]:
    """Return claim and band of a channel."""
    if channel not in predicted:
        raise InputError(f"{name}: predicts no {channel!r}; give every length of the training log")
    try:
        values = np.asarray(predicted[channel], dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: {channel} is no array of numbers ({error})") from error
    if values.shape not in ((count,), (count, 2)):
        raise InputError(
            f"{name}: {channel} has shape {values.shape}, the test has {count} samples; give "
            f"({count},) or, with a band, ({count}, 2)"
        )
    claim, band = (values, None) if values.ndim == 1 else (values[:, 0], values[:, 1])
    if not np.isfinite(claim).all():
        raise InputError(f"{name}: {channel} is not finite everywhere; predict every sample")
    if band is not None and not (np.isfinite(band) & (band >= 0.0)).all():
        raise InputError(
            f"{name}: the band of {channel} is negative or not finite; give its half-width, m"
        )
    return claim, band
