"""Tune and simulate a closed loop as defined by its file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer
from estimator.noise import sensor_noise
from fesim.case.schema import MOST_STEPS, Case, read_case, step_count
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.compensation.loop.controller import Controller
from thermojoint.compensation.loop.linear import (
    Margins,
    Responses,
    frequencies_of,
    loop_channels,
    margins_of,
    open_loop,
    responses_of,
)
from thermojoint.compensation.loop.march import Acting, Course, Plant, check_plant, run_loop
from thermojoint.compensation.loop.schema import HeaterSection, Loop
from thermojoint.compensation.loop.tuning import Requirements, Tuned, feed_forward_gain, tune
from thermojoint.compensation.offsets.settings import (
    Settings,
    check_axes,
    read_settings,
    with_slopes,
)

#: Standard deviation of the noise assumed in tuning, relative to its peak-to-peak value.
RMS = 1.0 / 6.0

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Design:
    """The heater's loop near the preload."""

    tuned: Tuned
    responses: Responses
    #: Delay of the estimates (s) to the margins of the same controller with it.
    late: dict[float, Margins]


@dataclass(frozen=True, eq=False)
class Closed:
    """Results of a closed loop.

    Attributes
    ----------
    loop : Loop
    axes : tuple of str
    design : Design or None
        None without a heater.
    free : Course
        Run without heat from the heater, with offsets if there are any.
    heated : Course or None
        Run with the heater; None without one.
    late : dict of float to Course
        Runs with all actuators, for each tested delay (s).
    followed : tuple of str
        Axes that offsets follow.
    """

    loop: Loop
    axes: tuple[str, ...]
    design: Design | None
    free: Course
    heated: Course | None
    late: dict[float, Course]
    followed: tuple[str, ...] = ()


def close_loop(loop: Loop, progress: Progress | None = None) -> Closed:
    """Tune and simulate a closed loop.

    Parameters
    ----------
    loop : Loop
        Content of its file.
    progress : callable, optional
        Called with a description of the next stage.

    Raises
    ------
    InputError
        The contents of the file are inconsistent, or no controller meets the requirements.
    ConvergenceError
        The machine or the estimator does not converge.
    """
    report = progress or (lambda _: None)
    estimator = JointAware(read_observer(loop.estimator.model))
    settings = None if loop.offsets is None else read_settings(loop.offsets)
    if settings is not None:
        # In a loop the machine and its model do not move their axes.
        with_slopes(settings, {}, str(loop.offsets))
        check_axes(settings, estimator.axes, str(loop.offsets))
        _check_followed_once(settings, str(loop.offsets))
    case = plant_case(loop)
    check_plant(case, estimator)
    for delay in (loop.estimator.delay_s, *loop.tried_delays_s):
        _samples(delay, estimator.model.step)
    _check_length(loop, case, estimator)
    _check_age(settings, loop, estimator.model.step)
    noise = _noise(loop, case, estimator)
    design = _design(loop, loop.heater, estimator) if loop.heater is not None else None
    report("setting up the plant")
    plant = Plant(case, set_up(case))
    idle = _acting(loop, case, estimator, None, settings, loop.estimator.delay_s)
    report("free")
    free = run_loop(plant, estimator, idle, noise)

    def acted(delay: float) -> Course:
        controller = design.tuned.controller if design is not None else None
        report(f"controlled, delay {delay:g} s")
        acting = _acting(loop, case, estimator, controller, settings, delay)
        return run_loop(plant, estimator, acting, noise)

    heated = acted(loop.estimator.delay_s) if design is not None else None
    late = {delay: acted(delay) for delay in loop.tried_delays_s}
    followed = () if settings is None else settings.output.estimated
    return Closed(loop, estimator.axes, design, free, heated, late, followed)


def _check_followed_once(settings: Settings, where: str) -> None:
    """Refuse two axes that follow one displacement: what each moves is added to it."""
    first: dict[str, str] = {}
    for name, followed in zip(settings.output.names, settings.output.estimated, strict=True):
        if (other := first.setdefault(followed, name)) != name:
            raise InputError(
                f"{where}: axes {other} and {name} both follow {followed}, and a loop would move "
                "it twice; leave one of them out"
            )


def plant_case(loop: Loop) -> Case:
    """Return the plant of a loop as a case with the loop's heat input and an unheated heater.

    Raises
    ------
    InputError
        The case is unusable, or has no such heater.
    """
    case = read_case(loop.plant.case)
    heater = loop.heater
    if heater is not None and heater.source not in case.sources:
        raise unknown_name("source", heater.source, case.sources, "heater")
    silent = StepInput(kind="step", level=0.0)
    sources = {
        name: source.model_copy(
            update={
                "heat_input": silent
                if heater is not None and name == heater.source
                else loop.plant.heat_input
            }
        )
        for name, source in case.sources.items()
    }
    march = case.march.model_copy(update={"duration_min": loop.plant.duration_min})
    return case.model_copy(
        update={"sources": sources, "march": march, "title": loop.title, "candidates": []}
    )


def _design(loop: Loop, heater: HeaterSection, estimator: JointAware) -> Design:
    model = estimator.model
    channels = loop_channels(model, heater.source, heater.against, heater.axis)
    responses = responses_of(model, channels, frequencies_of(model))
    start = Controller(
        gain=1.0,
        integral_time=1.0,
        derivative_time=0.0,
        derivative_filter=model.step,
        sign=math.copysign(1.0, responses.heater.displacement[0].real),
        feed_forward=feed_forward_gain(model, channels, model.calibrated.duration_s),
        feed_forward_filter=0.0,
        largest=heater.largest_W,
        resolution=heater.resolution_W,
        interval=model.step,
        setpoint=1e-6 * heater.setpoint_um,
    )
    required = loop.tuning
    tuned = tune(
        responses,
        start,
        Requirements(
            gain_margin=10.0 ** (required.gain_margin_dB / 20.0),
            phase_margin=math.radians(required.phase_margin_deg),
            gain_error=required.gain_error,
            delay=loop.estimator.delay_s,
            delay_error=required.delay_error_s,
            noise=np.append(np.full(len(model.sensors), RMS * loop.estimator.noise_pp_K), 0.0),
            most_noise=required.heat_noise * heater.largest_W,
        ),
    )
    late = {
        delay: margins_of(responses.frequencies, open_loop(responses, tuned.controller, delay))
        for delay in loop.tried_delays_s
    }
    return Design(tuned, responses, late)


def _acting(
    loop: Loop,
    case: Case,
    estimator: JointAware,
    controller: Controller | None,
    settings: Settings | None,
    delay: float,
) -> Acting:
    heater, model = loop.heater, estimator.model
    return Acting(
        controller=controller,
        heater=-1 if heater is None else list(case.sources).index(heater.source),
        disturbance=0 if heater is None else model.sources.index(heater.against),
        axis=0 if heater is None else model.axes.index(heater.axis),
        offsets=settings,
        delay=_samples(delay, model.step),
    )


def _samples(delay: float, step: float) -> int:
    """Number of samples of a delay (s)."""
    if abs(delay / step - round(delay / step)) > 1e-6:
        raise InputError(
            f"delay of {delay:g} s: not a multiple of the estimator's step of {step:g} s; change "
            "it to one"
        )
    return round(delay / step)


def _sample_count(case: Case, estimator: JointAware) -> int:
    """Number of samples of a run: it ends with a whole step of the estimator."""
    each = max(1, round(estimator.model.step / case.march.step_s))
    return step_count(case.march) // each


def _check_length(loop: Loop, case: Case, estimator: JointAware) -> None:
    """Refuse a run with too many steps, or in which nothing is evaluated or no estimate arrives."""
    step, minutes = estimator.model.step, loop.plant.duration_min
    at = f"plant: duration_min {minutes:g}"
    if 60.0 * minutes > MOST_STEPS * case.march.step_s:
        raise InputError(
            f"{at} has more than {MOST_STEPS} steps of the case's step_s {case.march.step_s:g}; "
            "make it shorter"
        )
    end = _sample_count(case, estimator) * step
    if end <= 0.0 or 60.0 * loop.plant.judged_from_min > end:
        raise InputError(
            f"{at}: with whole steps of the estimator, of {step:g} s, the run ends at "
            f"{end / 60.0:g} min, and nothing of it counts; make it longer, or judged_from_min "
            "smaller"
        )
    for delay in (loop.estimator.delay_s, *loop.tried_delays_s):
        if delay >= end:
            raise InputError(f"delay of {delay:g} s: {at} ends before; make the delay shorter")


def _noise(loop: Loop, case: Case, estimator: JointAware) -> Array:
    """Noise on every sensor at every sample, K, shape (samples, sensors)."""
    count, sensors = _sample_count(case, estimator), len(estimator.model.sensors)
    if loop.estimator.noise_pp_K <= 0.0:
        return np.zeros((count, sensors))
    times = estimator.model.step * np.arange(count)
    return sensor_noise(times, loop.estimator.noise_pp_K, loop.estimator.seed, sensors)


def _check_age(settings: Settings | None, loop: Loop, step: float) -> None:
    """Refuse estimates that are too old on arrival, or before the next one arrives."""
    if settings is None:
        return
    oldest, told = settings.trust.oldest, ""
    if oldest <= step:
        told = f"not longer than the estimator's step of {step:g} s"
    tried = [("tried_delays_s", delay) for delay in loop.tried_delays_s]
    for name, delay in (*tried, ("estimator.delay_s", loop.estimator.delay_s)):
        if oldest < delay:
            told = f"shorter than {name} {delay:g}"
    if told:
        raise InputError(
            f"{loop.offsets}: oldest_s {oldest:g} is {told}: no offset would follow; make it longer"
        )
