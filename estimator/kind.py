"""A kind of estimator: what the commands, the service and the exporters need to know of it.

A kind is a folder beside `estimator.fchs` with one `Kind`, and one line in `estimator.registry`; or
the same in another distribution, named by an entry point. What a kind leaves out is as for the
simplest one: its file holds all that the estimator is, so that its model is the estimator, and a
sample holds what is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from estimator.columns import samples_of
from estimator.intake import Intake, by_channels
from estimator.interface import READING_NOISE, Estimator
from estimator.judging import Conditions, Figures, judge_responses
from estimator.ranges import Range
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log

if TYPE_CHECKING:
    import xarray as xr

    from estimator.export.program import Contents, Precision

Sample = tuple[float, ...]
#: Called with the first row of a log as it was read: column to value.
OnFirst = Callable[[Mapping[str, float]], None]


class OpenedEstimator(Estimator, Protocol):
    """An estimator that comes from a file.

    Attributes
    ----------
    schema : str
        Of its model file: by it the registry knows its kind.
    model : object
        What the file holds; a `Kind` takes it.
    """

    @property
    def schema(self) -> str:
        """Schema of the model file."""
        ...

    @property
    def model(self) -> Any:  # noqa: ANN401
        """What the model file holds."""
        ...


@dataclass(frozen=True)
class Options:
    """How an estimator is started; a kind says which of the last three it takes.

    Attributes
    ----------
    interval, run_length : float
        Nominal sampling interval and length of a run, s, for what is made for them.
    reading_noise : float, optional
        Standard deviation of a displacement that is read, m; default `READING_NOISE`.
    ageing : tuple of str
        Parameters of the machine that are learnt as it runs.
    regression : str, optional
        Which regression of a file of baselines; default ``ridge``.
    """

    interval: float = 2.0
    run_length: float = 7200.0
    reading_noise: float | None = None
    ageing: tuple[str, ...] = ()
    regression: str | None = None

    @property
    def noise(self) -> float:
        """Standard deviation of a displacement that is read, m."""
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


def _no_ranges(model: Any) -> tuple[Range, ...]:  # noqa: ANN401
    return ()


def _as_it_is(model: Any) -> Mapping[str, str]:  # noqa: ANN401
    return {}


@dataclass(frozen=True)
class Kind(Generic[M, E]):
    """All that is asked of a kind of estimator.

    Attributes
    ----------
    name : str
        What a person calls one, for messages: ``a learned model``.
    read : callable
        Path to the model that the file holds; raises `InputError`.
    fingerprint : callable
        Model to a text that no other model has: a state goes on with the same one.
    start : callable
        (model, options) to the estimator.
    options : frozenset of str
        Which of ``reading_noise``, ``ageing``, ``regression`` it takes.
    paced : bool
        The estimator is made for a nominal sampling interval.
    warm_state : callable, optional
        Estimator to its state on a machine of whose past nothing is known.
    carried, resumed : callable, optional
        Estimator to what its states carry beside their numbers, as JSON has it; (model, options,
        that, name of the file) to the estimator that goes on.
    intake : callable
        (model, whether temperatures are told above the ambient) to what a machine reads.
    renamed : callable
        Model to what a log's columns are called by it, as `thermojoint.artefacts.log_file.read_log`
        takes it.
    log : callable
        (model, a log in pieces, its name, what is to be told of the first row) to samples.
    response, sensors : callable
        (model, response) to samples, and to the names of the probes they are of.
    ranges : callable
        Model to what it was calibrated for.
    judge : callable, optional
        (kind, model, name to response, conditions) to errors; None for a kind that only logs judge.
    judge_logs : callable, optional
        (model, name to log) to errors; None for a kind that only responses judge.
    residuals : callable, optional
        (estimator, state, sample as `channels`) to reading minus model, NaN for what is missing.
    program : callable, optional
        (estimator, precision, nominal interval s) to what it gives to a program for a control.
    """

    name: str
    read: Callable[[Path], M]
    fingerprint: Callable[[M], str]
    start: Callable[[M, Options], E] = _itself
    options: frozenset[str] = frozenset()
    paced: bool = False
    warm_state: Callable[[E], Array] | None = None
    carried: Callable[[E], Any] | None = None
    resumed: Callable[[M, Options, Any, str], E] | None = None
    intake: Callable[[M, bool], Intake] = _intake
    renamed: Callable[[M], Mapping[str, str]] = _as_it_is
    log: Callable[[M, Iterable[Log], str, OnFirst | None], Iterator[Sample]] = _log
    response: Callable[[M, xr.Dataset], Iterator[Sample]] = _response
    sensors: Callable[[M, xr.Dataset], Sequence[str]] = _sensors
    ranges: Callable[[M], tuple[Range, ...]] = _no_ranges
    judge: Callable[[Kind[M, E], M, Mapping[str, xr.Dataset], Conditions], Figures] | None = _judged
    judge_logs: Callable[[M, Mapping[str, Log]], Figures] | None = None
    residuals: Callable[[E, Array, Array], Array] | None = None
    program: Callable[[E, Precision, float], Contents] | None = None
