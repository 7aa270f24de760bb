"""Registry of estimators: the schema of a model file determines its kind.

A kind from another distribution is named by an entry point of the group `GROUP`: its name is the
schema of the model files, its value the location of the `estimator.kind.Kind`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from estimator import states
from estimator.kind import Kind, OpenedEstimator, Options
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.schema import schema_of

GROUP = "thermojoint.estimators"
#: Schema of a model file to the location of its kind, which is imported on demand.
KINDS = {
    "thermojoint-model": "estimator.fchs.kind:KIND",
    "thermojoint-assembly": "estimator.fchs.kind:KIND",
    "thermojoint-baselines": "estimator.baselines.kind:KIND",
    "thermojoint-learned-model": "estimator.learned.kind:KIND",
    "thermojoint-joint-aware-model": "estimator.joint_aware.kind:KIND",
}


def known_schemas() -> dict[str, str]:
    """Return the schema of every kind of model that can be opened, and the location of the kind."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)} | KINDS


def kind_of_file(path: Path | str) -> Kind[Any, Any]:
    """Return the kind of a model file.

    Raises
    ------
    InputError
        The file is missing or unreadable, or no model of a kind that is installed.
    """
    schema = schema_of(path)
    if schema not in known_schemas():
        raise InputError(
            f"{path}: {schema!r} is not an installed kind of model; give what 'calibrate', "
            "'assemble' or 'learn' wrote"
        )
    return _kind(schema)


def kind_of(estimator: OpenedEstimator) -> Kind[Any, Any]:
    """Return the kind of an opened estimator."""
    return _kind(estimator.schema)


def open_estimator(
    path: Path | str,
    *,
    interval: float = 2.0,
    run_length: float = 7200.0,
    reading_noise: float | None = None,
    ageing: tuple[str, ...] = (),
    regression: str | None = None,
) -> OpenedEstimator:
    """Open a model file of any kind: return its estimator.

    Parameters
    ----------
    path : Path or str
        A model file of any kind, or an assembled estimator.
    interval, run_length : float
        Nominal sampling interval and length of a run, s; kinds that are not assembled for them
        ignore them.
    reading_noise : float, optional
        Standard deviation of a displacement reading, m (learned, joint-aware).
    ageing : tuple of str
        Parameters learned online: ``preload``, ``friction``, ``film`` (joint-aware).
    regression : str, optional
        ``mlr``, ``ridge`` (default) or ``arx`` (a file of baselines).

    Raises
    ------
    InputError
        The file is unusable or of no known kind, or an option is not for this kind.
    ConvergenceError
        The model cannot be assembled at the interval and run length.
    """
    kind = kind_of_file(path)
    options = Options(interval, run_length, reading_noise, ageing, regression)
    return started(kind, kind.read(Path(path)), options)


def resume_estimator(
    path: Path | str,
    state: Path | str,
    *,
    reading_noise: float | None = None,
    ageing: tuple[str, ...] = (),
    regression: str | None = None,
) -> tuple[OpenedEstimator, Array]:
    """Return the estimator of a model with a state written by `save_state` for the same model.

    Parameters
    ----------
    path : Path or str
        A model file of any kind.
    state : Path or str
        The saved state.
    reading_noise, ageing, regression
        As in `open_estimator`.

    Raises
    ------
    InputError
        A file is unusable, or the state belongs to another model.
    """
    kind = kind_of_file(path)
    options = Options(reading_noise=reading_noise, ageing=ageing, regression=regression)
    return resumed(kind, kind.read(Path(path)), options, state)


def save_state(
    estimator: OpenedEstimator, state: Array, path: Path | str, cold: float = math.nan
) -> None:
    """Write the state of an estimator, whole or not at all.

    Parameters
    ----------
    estimator : OpenedEstimator
        From `open_estimator`.
    state : ndarray
        From its last sample, or its initial state.
    path : Path or str
        JSON to write.
    cold : float
        Ambient at which the machine was cold, K, for kinds that are relative to it (`Cold`).

    Raises
    ------
    InputError
        The state is not finite: an earlier sample was too large to be a measurement.
    """
    kind = kind_of(estimator)
    states.write_state(
        states.SavedState(
            estimator.schema,
            kind.fingerprint(estimator.model),
            kind.carried(estimator) if kind.carried else None,
            state,
            cold,
        ),
        path,
    )


def started(kind: Kind[Any, Any], model: Any, options: Options) -> OpenedEstimator:  # noqa: ANN401
    """Return the estimator of a model; refuses options that its kind does not take."""
    _check(kind, options)
    estimator: OpenedEstimator = kind.start(model, options)
    return estimator


def resumed(
    kind: Kind[Any, Any],
    model: Any,  # noqa: ANN401
    options: Options,
    path: Path | str,
) -> tuple[OpenedEstimator, Array]:
    """Return the estimator of a model, and its saved state; raises as `resume_estimator`."""
    _check(kind, options)
    saved = states.read_state(path)
    schemas = known_schemas()
    same_kind = schemas.get(saved.schema) in schemas.values() and _kind(saved.schema) is kind
    if not same_kind or saved.fingerprint != kind.fingerprint(model):
        raise InputError(
            f"{path}: state of another model; start afresh, or use the model it was saved with"
        )
    estimator: OpenedEstimator
    if kind.resumed is None:
        estimator = kind.start(model, options)
    else:
        estimator = kind.resumed(model, options, saved.carried, str(path))
    initial = estimator.initial_state()
    values = states.completed(saved.values, initial)
    if values.size != initial.size:
        raise InputError(f"{path}: the state's values are damaged; start afresh")
    return estimator, values


@lru_cache
def _kind(schema: str) -> Kind[Any, Any]:
    kind = resolve_name(known_schemas()[schema])
    if not isinstance(kind, Kind):
        raise InputError(
            f"{known_schemas()[schema]}: is not a kind of estimator; fix the entry point in the "
            "distribution that has it"
        )
    return kind


def _check(kind: Kind[Any, Any], options: Options) -> None:
    for name in ("reading_noise", "ageing", "regression"):
        if getattr(options, name) not in (None, ()) and name not in kind.options:
            raise InputError(f"{name.replace('_', ' ')}: not for {kind.name}; leave it out")
