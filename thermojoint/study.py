"""The chain across the packages: simulate, place, calibrate, validate. Data in, data out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from artefacts.errors import ConvergenceError, InputError, ThermojointError
from calibrate.driven_deformation import fit_driven_deformation, uncertain_signals
from calibrate.fictitious import FictitiousCalibration, calibrate_fictitious
from calibrate.linear import (
    JOINT_SENSORS,
    LinearCalibration,
    calibrate_displacements,
    calibrate_heat,
    with_direct_models,
)
from calibrate.model import (
    DeformationModel,
    FictitiousSource,
    Model,
    Regularisation,
    RingModel,
)
from calibrate.source_thermal import Averaging, fit_by_averaging, make_geometry
from estimator import blocks
from estimator.assembly import start
from estimator.fchs import Estimate
from estimator.inverse import unstable_zeros
from estimator.validation import block_errors, readings, sensor_noise, validate
from fesim.case import Case, StepInput, TriangleInput
from fesim.setup import Setup, set_up
from fesim.simulate import simulate
from thermojoint.calibration_input import (
    ROLES,
    candidates_in,
    check_drivable,
    check_probes,
    check_responses,
    checked_distances,
    moving_axes,
    probes_of,
    reference_power,
)
from thermojoint.measured import roles_in
from thermojoint.placement import (
    APART,
    DEVIATION_UNCERTAINTY,
    Placement,
    choose_heat_pair,
    rank_joint_pairs,
    sources_for,
    with_roles,
)

if TYPE_CHECKING:
    import xarray as xr

HeatInput = StepInput | TriangleInput
Report = Callable[[str, int, int], None]

CALIBRATION: dict[str, HeatInput] = {
    "step-0.5": StepInput(kind="step", level=0.5),
    "step-1.0": StepInput(kind="step", level=1.0),
    "step-2.0": StepInput(kind="step", level=2.0),
}
VALIDATION: dict[str, HeatInput] = {
    "step-1.5": StepInput(kind="step", level=1.5),
    "step-3.0": StepInput(kind="step", level=3.0),
    "triangle": TriangleInput(kind="triangle", peak=2.0, duration_min=10.0),
}
NOISE_PEAK_TO_PEAK_K = 0.12
NOISE_SEED = 0
#: Largest factor on A that `stabilised` tries.
MOST_RAISED = 64.0
#: Joint pairs that the placement tries before it gives up.
MOST_PAIRS = 40


@dataclass(frozen=True)
class Calibrated:
    """A model and how it came about.

    Attributes
    ----------
    model : Model
    linear : LinearCalibration
        Table 1.
    fictitious : FictitiousCalibration
        Tables 2 and 3.
    averaging : Averaging
        The loop of Figure 4 on the same data as Table 2, to compare; the model does without it.
    placement : Placement or None
        None if the responses named their sensors.
    """

    model: Model
    linear: LinearCalibration
    fictitious: FictitiousCalibration
    averaging: Averaging
    placement: Placement | None


@dataclass(frozen=True)
class Validated:
    """The estimator against responses.

    Attributes
    ----------
    rows : list of dict
        See `estimator.validation.validate`.
    vectors : list of dict
        case, estimator, max_abs_error_um: largest length of the error in all axes together.
    as_printed : list of dict
        `rows` of the paper's own scheme, whose deformation models are calibrated to steps.
    blocks : list of dict
        See `estimator.validation.block_errors`; empty without a reference response.
    estimates : dict
        Case to the whole run.
    """

    rows: list[dict[str, str | float]]
    vectors: list[dict[str, str | float]]
    as_printed: list[dict[str, str | float]]
    blocks: list[dict[str, str | float]]
    estimates: dict[str, Estimate]

    def figures(self) -> dict[str, list[dict[str, str | float]]]:
        """All errors, ready for a JSON file."""
        return {
            "rows": self.rows,
            "vectors": self.vectors,
            "as_printed": self.as_printed,
            "blocks": self.blocks,
        }


def simulate_inputs(
    case: Case,
    inputs: Mapping[str, HeatInput],
    *,
    setup: Setup | None = None,
    progress: Report | None = None,
) -> dict[str, xr.Dataset]:
    """Return the response of one structure to several heat inputs; it is set up once.

    Raises
    ------
    InputError
        Something else than the heat inputs would act on the structure, too.
    """
    check_drivable(case)
    ready = setup if setup is not None else set_up(case)

    def run(name: str, heat: HeatInput) -> xr.Dataset:
        def told(done: int, count: int) -> None:
            if progress is not None:
                progress(name, done, count)

        own = case.model_copy(update={"heat_input": heat, "title": f"{case.title}, {name}"})
        return simulate(own, setup=ready, progress=told).response

    return {name: run(name, heat) for name, heat in inputs.items()}


@threadpool_limits.wrap(limits=1)
def calibrate_responses(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]] | None = None,
) -> Calibrated:
    """Return the calibrated model of a structure from its responses to steps.

    Every axis along which something moves is calibrated (`calibration_input.moving_axes`).

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step.
    others : mapping
        Heat input to the response to it.
    distances : sequence of sequences, optional
        r_ij, m, from fictitious source i to sensor T_j, if the responses name their sensors.
        Default: the sources lie at the contact elements nearest to the sensors.

    Raises
    ------
    InputError
        The responses do not fit each other, sensors are missing and there are no candidates to
        choose from, or no choice of them gives a stable estimator.
    ConvergenceError
        The sensors that the responses name give no stable estimator.
    """
    check_responses(reference, others)
    named = set(probes_of(reference)) >= set(ROLES)
    if distances is not None and not named:
        raise InputError(
            "distances: they belong to sensors that are named; name the probes a, b, T1 and T2"
        )
    near_source, at_joint = ([], []) if named else candidates_in(reference)
    check_probes(others, ROLES if named else (*near_source, *at_joint))
    axes = moving_axes(reference, others)
    base = reference.sel(axis=axes)
    rest = {level: response.sel(axis=axes) for level, response in others.items()}
    if not named:
        return _place_and_calibrate(base, rest, near_source, at_joint)
    if distances is None:
        table = sources_for(base, JOINT_SENSORS)[1].tolist()
    else:
        table = checked_distances(distances)
    return _calibrate(base, rest, table, calibrate_heat(base, calibrate_displacements(base)), None)


@threadpool_limits.wrap(limits=1)
def validate_model(
    model: Model,
    reference: xr.Dataset | None,
    responses: Mapping[str, xr.Dataset],
    noisy: Collection[str] = (),
) -> Validated:
    """Judge a model by responses, from temperatures alone.

    Parameters
    ----------
    model : Model
        What is judged.
    reference : xarray.Dataset, optional
        Response to the reference step, to tell the actual nonlinear part.
    responses : mapping
        Name to response.
    noisy : collection of str
        Names of responses to judge once more with `joint_noise`, as "NAME-noise".
    """
    printed = replace(model, sources=tuple(replace(one, driven={}) for one in model.sources))
    found = Validated([], [], [], [], {})
    for name, response in responses.items():
        roles = roles_in(response, model)
        again = {f"{name}-noise": joint_noise(response)} if name in noisy else {}
        for case, noise in ({name: None} | again).items():
            rows, estimate = validate(
                case, response, model, reference=reference, roles=roles, noise=noise
            )
            found.rows.extend(rows)
            found.vectors.extend(_vector_errors(case, response, model, estimate))
            found.estimates[case] = estimate
            as_printed, _ = validate(
                case, response, printed, reference=reference, roles=roles, noise=noise
            )
            found.as_printed.extend(row for row in as_printed if row["estimator"] == "fchs")
            if reference is not None:
                found.blocks.extend(
                    block_errors(case, response, model, reference, roles=roles, noise=noise)
                )
    return found


def _vector_errors(
    case: str, response: xr.Dataset, model: Model, estimate: Estimate
) -> list[dict[str, str | float]]:
    actual = response["displacement"].sel(axis=list(model.linear.deformation)).to_numpy()
    return [
        {
            "case": case,
            "estimator": name,
            "max_abs_error_um": 1e6 * float(np.linalg.norm(claimed - actual, axis=1).max()),
        }
        for name, claimed in (("linear", estimate.linear), ("fchs", estimate.total))
    ]


def joint_noise(response: xr.Dataset) -> dict[str, np.ndarray]:
    """Noise on T1 and T2, as in the paper: about 0.12 K peak to peak, high-pass, seeded."""
    channels = sensor_noise(
        response["time"].to_numpy(), NOISE_PEAK_TO_PEAK_K, NOISE_SEED, len(JOINT_SENSORS)
    )
    return {role: channels[:, k] for k, role in enumerate(JOINT_SENSORS)}


def _place_and_calibrate(
    base: xr.Dataset, rest: Mapping[float, xr.Dataset], near_source: list[str], at_joint: list[str]
) -> Calibrated:
    axes = [str(axis) for axis in base["axis"].to_numpy()]
    displacements = calibrate_displacements(base)
    shapes = {axis: shape for axis, (shape, _) in displacements.items()}
    heat = choose_heat_pair(base, rest, shapes, near_source)
    by_source = calibrate_heat(with_roles(base, {"a": heat.a, "b": heat.b}), displacements)
    refused = ""
    for pair in islice(rank_joint_pairs(base, rest, axes, at_joint), MOST_PAIRS):
        placement = Placement(heat, pair, *sources_for(base, (pair.T1, pair.T2)))
        own = with_roles(base, placement.roles)
        named = {level: with_roles(response, placement.roles) for level, response in rest.items()}
        try:
            return _calibrate(own, named, placement.distances.tolist(), by_source, placement)
        except ThermojointError as error:
            # The responses are sound and a and b are chosen: what fails here fails by this pair.
            refused = str(error)
    if not refused:
        raise InputError(
            f"placement: no two candidates at the joint lie {APART:g} m apart; give more "
            "[[candidates]] there"
        )
    raise InputError(
        f"placement: none of the best {MOST_PAIRS} pairs at the joint gives a stable estimator "
        f"({refused}); give other [[candidates]]"
    )


def _calibrate(
    base: xr.Dataset,
    rest: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]],
    by_source: LinearCalibration,
    placement: Placement | None,
) -> Calibrated:
    """Calibrate with named sensors; `by_source` is Table 1 but for T1 and T2."""
    linear = with_direct_models(by_source, base)
    fictitious = calibrate_fictitious(base, rest, distances)
    position = base["probe_position"].sel(probe=list(ROLES)).to_numpy()
    model = Model(
        linear=linear.model,
        sources=fictitious.sources,
        distances=tuple(tuple(map(float, row)) for row in distances),
        sensors={
            role: (float(x), float(y), float(z))
            for role, (x, y, z) in zip(ROLES, position, strict=True)
        },
        reference_power_W=reference_power(base),
    )
    model = stabilised(model, base["time"].to_numpy())
    model = replace(model, sources=_driven_models(model, base, rest, fictitious))
    data = fictitious.deviations
    averaging = fit_by_averaging(data.t, data.temperatures, data.inputs, make_geometry(distances))
    return Calibrated(model, linear, fictitious, averaging, placement)


def stabilised(model: Model, times: np.ndarray) -> Model:
    """Raise A of every source (Eq. 7) together until the matrix of the sources has an inverse.

    The rule for A looks at each source alone. Beside each other, a source may be felt more at the
    other's sensor than at its own; a larger A, and with it B, makes the own sensor count first.

    Raises
    ------
    ConvergenceError
        The inverse is unstable even with `MOST_RAISED` times the A of the rule.
    """
    rings = [
        [RingModel(one.K, one.a, one.alpha, r, one.r0) for r in row]
        for one, row in zip(model.sources, model.distances, strict=True)
    ]
    interval, length = float(np.diff(times).min()), float(times[-1] - times[0])
    factor = 1.0
    while factor <= MOST_RAISED:
        raised = [_raised(one.regularisation, factor) for one in model.sources]
        if unstable_zeros(rings, raised, interval, length, "inverse of the sources") == 0:
            sources = zip(model.sources, raised, strict=True)
            return replace(
                model, sources=tuple(replace(one, regularisation=f) for one, f in sources)
            )
        factor *= 2.0
    raise ConvergenceError(
        f"inverse of the sources: unstable even with A raised {MOST_RAISED:g} times; place the "
        "sensors nearer to their own sources"
    )


def _raised(f: Regularisation, factor: float) -> Regularisation:
    return Regularisation(factor * f.A, factor * f.B, f.gamma)


def _driven_models(
    model: Model,
    base: xr.Dataset,
    rest: Mapping[float, xr.Dataset],
    fictitious: FictitiousCalibration,
) -> tuple[FictitiousSource, ...]:
    """Calibrate Eq. 18 to the strengths that the estimator sees in the calibration responses.

    Runs of mere temperature error stand beside them, which must give no displacement.
    """
    times = base["time"].to_numpy()
    estimator = start(model, float(np.diff(times).min()), float(times[-1] - times[0]))
    levels = [float(level) for level in fictitious.deviations.inputs]
    after = times > 0.0
    runs = []
    for level in levels:
        seen = readings(rest[level], model)
        heat = blocks.heat_part(estimator, times, seen.delta_T)
        runs.append(blocks.deviations(estimator, times, heat, seen.temperatures))
    still = uncertain_signals(times, DEVIATION_UNCERTAINTY, estimator.n_sources, NOISE_SEED)
    strengths = np.stack(
        [blocks.source_part(estimator, times, run)[after] for run in (*runs, *still)]
    ).transpose(2, 0, 1)
    shapes: dict[str, tuple[DeformationModel, ...]] = {}
    for axis, target in fictitious.deviations.displacements.items():
        nothing = np.zeros((len(still), int(after.sum())))
        wanted = np.concatenate([target[:, after], nothing])
        shapes[axis] = fit_driven_deformation(times[after], wanted, strengths)[0]
    return tuple(
        replace(source, driven={axis: models[i] for axis, models in shapes.items()})
        for i, source in enumerate(model.sources)
    )
