"""The chain across the packages: simulate, place, calibrate, validate. Data in, data out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import pydantic
import xarray as xr
from threadpoolctl import threadpool_limits

from artefacts.errors import ConvergenceError, InputError, ThermojointError
from calibrate import steps
from calibrate.driven_deformation import fit_driven_deformation, uncertain_signals
from calibrate.fictitious import FictitiousCalibration, calibrate_fictitious
from calibrate.linear import JOINT_SENSORS, LinearCalibration, calibrate_linear, fit_deformation
from calibrate.model import (
    DeformationModel,
    FictitiousSource,
    Model,
    Regularisation,
    RingModel,
)
from estimator import blocks
from estimator.assembly import start
from estimator.fchs import Estimate
from estimator.inverse import unstable_zeros
from estimator.validation import block_errors, readings, sensor_noise, validate
from fesim.case import CandidatesSection, Case, StepInput, TriangleInput
from fesim.setup import Setup, set_up
from fesim.simulate import simulate
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
#: The validation case that is run again with sensor noise at the joint.
NOISY = "triangle"
NOISE_PEAK_TO_PEAK_K = 0.12
NOISE_SEED = 0
#: The directions of Tables 1 and 3.
AXES = ("x", "y")
ROLES = ("a", "b", *JOINT_SENSORS)
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
    placement : Placement or None
        None if the responses named their sensors.
    """

    model: Model
    linear: LinearCalibration
    fictitious: FictitiousCalibration
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
    """Return the response of one structure to several heat inputs; it is set up once."""
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

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step.
    others : mapping
        Heat input to the response to it.
    distances : sequence of sequences, optional
        r_ij, m, from fictitious source i to sensor T_j. Default: the sources lie at the contact
        elements nearest to the sensors.

    Raises
    ------
    InputError
        Sensors are missing and there are no candidates to choose from, or the responses do not
        fit each other.
    ConvergenceError
        No choice of sensors gives a stable estimator.
    """
    axes = [axis for axis in AXES if axis in reference["axis"].to_numpy()]
    base = reference.sel(axis=axes)
    rest = {level: response.sel(axis=axes) for level, response in others.items()}
    known = {str(name) for name in base["probe"].to_numpy()}
    if known >= set(ROLES):
        table = distances if distances is not None else _distances_of(base)
        return _calibrate(base, rest, table, None)
    return _place_and_calibrate(base, rest)


@threadpool_limits.wrap(limits=1)
def validate_model(
    model: Model, reference: xr.Dataset | None, responses: Mapping[str, xr.Dataset]
) -> Validated:
    """Judge a model by responses, from temperatures alone; `NOISY` once more with noise.

    Parameters
    ----------
    model : Model
        What is judged.
    reference : xarray.Dataset, optional
        Response to the reference step, to tell the actual nonlinear part.
    responses : mapping
        Name to response.
    """
    printed = replace(model, sources=tuple(replace(one, driven={}) for one in model.sources))
    found = Validated([], [], [], [], {})
    for name, response in responses.items():
        roles = roles_in(response, model)
        noisy = {f"{name}-noise": joint_noise(response)} if name == NOISY else {}
        for case, noise in ({name: None} | noisy).items():
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


def _place_and_calibrate(base: xr.Dataset, rest: Mapping[float, xr.Dataset]) -> Calibrated:
    near_source, at_joint = _candidates(base)
    axes = [str(axis) for axis in base["axis"].to_numpy()]
    t = steps.times(base)
    shapes = {
        axis: fit_deformation(t, steps.displacement(base, axis, "reference"))[0] for axis in axes
    }
    heat = choose_heat_pair(base, rest, shapes, near_source)
    refused = ""
    for pair in islice(rank_joint_pairs(base, rest, axes, at_joint), MOST_PAIRS):
        placement = Placement(heat, pair, *sources_for(base, pair))
        own = with_roles(base, placement.roles)
        named = {level: with_roles(response, placement.roles) for level, response in rest.items()}
        try:
            return _calibrate(own, named, placement.distances.tolist(), placement)
        except ThermojointError as error:
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
    placement: Placement | None,
) -> Calibrated:
    linear = calibrate_linear(base)
    fictitious = calibrate_fictitious(base, dict(rest), distances)
    position = base["probe_position"].sel(probe=list(ROLES)).to_numpy()
    model = Model(
        linear=linear.model,
        sources=fictitious.sources,
        distances=tuple(tuple(map(float, row)) for row in distances),
        sensors={
            role: (float(x), float(y), float(z))
            for role, (x, y, z) in zip(ROLES, position, strict=True)
        },
        reference_power_W=float(base.attrs["reference_power_W"]),
    )
    model = stabilised(model, base["time"].to_numpy())
    driven = _driven_models(model, base, rest, fictitious)
    return Calibrated(replace(model, sources=driven), linear, fictitious, placement)


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


def _distances_of(response: xr.Dataset) -> list[list[float]]:
    if "contact_position" not in response:
        raise InputError(
            "calibrate: the response has no contact elements to put the fictitious sources at; "
            "give the distances r_ij from source i to sensor T_j"
        )
    sensors = response["probe_position"].sel(probe=list(JOINT_SENSORS)).to_numpy()
    elements = response["contact_position"].to_numpy()
    sources = [elements[np.argmin(np.linalg.norm(elements - x, axis=1))] for x in sensors]
    return [[float(np.linalg.norm(source - x)) for x in sensors] for source in sources]


def _candidates(response: xr.Dataset) -> tuple[list[str], list[str]]:
    """Return the probes in the case's two candidate boxes: around the source, and at the joint."""
    try:
        case = Case.model_validate_json(str(response.attrs.get("case", "")))
    except pydantic.ValidationError as error:
        missing = ", ".join(sorted(set(ROLES) - set(map(str, response["probe"].to_numpy()))))
        raise InputError(
            f"calibrate: the response has no probe {missing}; name the sensors a, b, T1 and T2"
        ) from error
    if len(case.candidates) != 2:
        raise InputError(
            f"candidates: the placement rule needs two boxes, the first around the source, the "
            f"second at the joint; the case has {len(case.candidates)}"
        )
    first, second = (_inside(response, box) for box in case.candidates)
    return first, second


def _inside(response: xr.Dataset, box: CandidatesSection) -> list[str]:
    position = 1e3 * response["probe_position"].to_numpy()
    low, high = np.array(box.low_mm) - 1e-6, np.array(box.high_mm) + 1e-6
    holds = ((position >= low) & (position <= high)).all(axis=1)
    return [str(name) for name in response["probe"].to_numpy()[holds]]
