"""The joint-aware estimator as a kind, and its variant with a linear joint (``kalman-linear``)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.intake import Intake, intake
from estimator.interface import NextReading
from estimator.joint_aware.ageing import AgeingJointAware
from estimator.joint_aware.channels import sample_channels
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.log import log_samples
from estimator.joint_aware.model_file import fingerprint, read_observer
from estimator.joint_aware.next_reading import narrowest_band, next_reading
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.readings import samples_in
from estimator.joint_aware.sample_values import split_sample
from estimator.judging import Figures, judge_log
from estimator.kind import Cold, Kind, OnFirst, Options, Sample, followed, judged_from_rest
from estimator.measured import announced
from estimator.ranges import Range, calibrated_ranges
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.response import displaced
from thermojoint.artefacts.units import MICRO, MILLI

if TYPE_CHECKING:
    import xarray as xr

    from estimator.export.program import Contents, Precision

#: With the calibrated parameters, or with parameters learned online.
JointAwareEstimator = JointAware | AgeingJointAware


def _start(model: ObserverModel, options: Options) -> JointAwareEstimator:
    if options.ageing and (model.moving_axes or model.power_shares):
        what = "with a moving axis" if model.moving_axes else "whose powers are read"
        raise InputError(f"ageing: not of a machine {what}; leave it out")
    observer = JointAware(model, options.noise)
    return AgeingJointAware(observer, options.ageing) if options.ageing else observer


def _ageing(estimator: JointAwareEstimator) -> list[str]:
    return list(estimator.ageing) if isinstance(estimator, AgeingJointAware) else []


def _resumed(
    model: ObserverModel,
    options: Options,
    carried: Any,  # noqa: ANN401
    where: str,
) -> JointAwareEstimator:
    if carried != list(options.ageing):
        names = ",".join(map(str, carried)) if isinstance(carried, list) else ""
        raise InputError(
            f"{where}: saved with {f'--ageing {names}' if names else 'no --ageing'}; give the same"
        )
    return _start(model, options)


def _intake(model: ObserverModel, above_ambient: bool) -> Intake:
    written = {
        "K": ("K" if above_ambient else "degC", 1.0),
        "1": ("percent", 0.01),
        "m": ("mm", MILLI),
        "W": ("W", 1.0),
    }
    channels = sample_channels(model)
    thermal, wanted = len(model.sensors) + 1, len(channels) - len(model.axes)
    read = [(channel.name, *written[channel.unit]) for channel in channels[:wanted]]
    names = [f"{name}_{unit}" for name, unit, _ in read] + [f"{axis}_um" for axis in model.axes]
    factors = [factor for _, _, factor in read] + [MICRO] * len(model.axes)
    zero_of = JointAware(model).zero_of

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        # The machine was cold at the first plausible ambient temperature on record.
        if math.isnan(cold):
            *sensed, ambient = readings[:thermal]
            cold = 0.0 if above_ambient else zero_of(np.array(sensed), ambient)
        values = [factor * value for factor, value in zip(factors, readings, strict=False)]
        values[:thermal] = [value - cold for value in values[:thermal]]
        return values, cold

    return intake(names, wanted, convert)


def _log(
    model: ObserverModel,
    pieces: Iterable[Log],
    where: str,
    on_first: OnFirst | None,
    cold: Cold,
) -> Iterator[tuple[float, ...]]:
    others = {
        **dict.fromkeys(model.loads, "percent"),
        **dict.fromkeys((*model.positions, *model.ways), "mm"),
        **dict.fromkeys(model.powers, "W"),
    }
    shown = announced(pieces, (*model.sensors, "ambient"), on_first)
    return log_samples(shown, model.sensors, where, others, cold, JointAware(model).zero_of)


def _response(model: ObserverModel, response: xr.Dataset) -> Iterator[tuple[float, ...]]:
    for name, apart in displaced(response, model.places):
        warnings.warn(
            f"joint-aware: probe {name!r} of the response is {1e3 * apart:.3g} mm from that of the "
            "model; read the thermometers that the model was calibrated with",
            stacklevel=2,
        )
    points = response.attrs.get("displacement_of", model.displacement_of)
    if model.displacement_of and points != model.displacement_of:
        warnings.warn(
            f"joint-aware: displacement of the response is that of {points}, and the model "
            f"estimates that of {model.displacement_of}; compare the same points",
            stacklevel=2,
        )
    axes = [axis.name for axis in model.moving_axes]
    counted = [axes[k] for k in model.counted]
    return samples_in(response, model.sensors, model.loads, axes, model.power_shares, counted)


def _ranges(model: ObserverModel) -> tuple[Range, ...]:
    known = model.calibrated
    return calibrated_ranges(known.duration_s, (0.0, known.heat), known.temperatures)


def _residuals(estimator: JointAwareEstimator, state: Array, values: Array) -> Array:
    """Reading minus model for every sensor, used or excluded."""
    known = _not_learning(estimator, "residuals")
    thermal = split_sample(known.precomputed, values.tolist()).temperatures
    return np.asarray(thermal - known.observer.system.rows @ unpacked(state, known.parts).linear)


def _next_reading(estimator: JointAwareEstimator, state: Array, limit: float) -> NextReading | None:
    return next_reading(_not_learning(estimator, "next reading"), state, limit)


def _not_learning(estimator: JointAwareEstimator, what: str) -> JointAware:
    if isinstance(estimator, AgeingJointAware):
        raise InputError(f"{what}: not while the machine's parameters are learnt")
    return estimator


def _program(
    estimator: JointAwareEstimator,
    precision: Precision,
    interval: float,
) -> Contents:
    from estimator.joint_aware.program import contents

    if isinstance(estimator, AgeingJointAware):
        raise InputError("export: ageing stays with 'thermojoint estimate'; leave it out")
    return contents(estimator, precision)


def _run(
    estimator: JointAwareEstimator, samples: Iterable[Sample], state: Array
) -> tuple[Array, Array]:
    if isinstance(estimator, AgeingJointAware):
        return followed(estimator, samples, state)
    return estimator.whole_run(np.array(list(samples)), state)


def _judge_logs(model: ObserverModel, logs: Mapping[str, Log]) -> Figures:
    estimator = _start(model, Options())

    def judged(name: str, log: Log) -> list[dict[str, str | float]]:
        def samples(run: Log) -> Iterator[Sample]:
            return _log(model, [run], name, None, Cold())

        return judge_log(name, estimator, judged_from_rest(name, estimator, log), samples)

    return {"rows": [row for name, log in logs.items() for row in judged(name, log)]}


KIND: Kind[ObserverModel, JointAwareEstimator] = Kind(
    name="a joint-aware model",
    read=read_observer,
    fingerprint=fingerprint,
    start=_start,
    options=frozenset({"reading_noise", "ageing"}),
    warm_state=lambda estimator: estimator.warm_state(),
    carried=_ageing,
    resumed=_resumed,
    intake=_intake,
    log=_log,
    response=_response,
    sensors=lambda model, response: model.sensors,
    run=_run,
    ranges=_ranges,
    judge_logs=_judge_logs,
    residuals=_residuals,
    next_reading=_next_reading,
    narrowest_band=lambda estimator: narrowest_band(_not_learning(estimator, "next reading")),
    program=_program,
    strokes=lambda model: model.strokes,
)
