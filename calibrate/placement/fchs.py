"""Placement rule for the sensors a, b, T1, T2 ..., from calibration data alone.

It uses the responses to the calibration steps, never a validation case. All choices are judged by
the displacement error, so both halves of the rule are in micrometres. Bounds are relative to the
machine at hand: to its largest temperature difference, to the extent of the candidates, to the
length of the run.

Heat (a, b). Of all pairs, keep those whose difference is proportional to the heat input, monotone
and large (`Rule` has the bounds). Where no pair is proportional within the bound, as in runs of
hours in which the joint changes the whole temperature field, the bound is doubled until one is;
the placement states what was reached. Of these take a shortlist of those that respond fastest (a
fast pair needs little regularisation). Fit Eq. 2 to each, build its inverse, and choose the pair
whose estimated linear displacement is best at all calibration inputs.

Joint (T1, T2 ...). Pass every candidate's temperature deviation through four low-pass filters and
fit the nonlinear displacement at the calibration inputs with each set of candidates, regularised
for the uncertainty of a deviation. Rank the sets by the residual; sensors that are too close would
see one source twice. Sets with a sensor whose deviation never exceeds its uncertainty come last.
The first set whose source model has a stable inverse is used. Fictitious source i lies at the
contact element nearest to T_i, which determines r_ij.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from calibrate.driven_deformation import UNCERTAIN
from calibrate.linear import fit_ring
from thermojoint.artefacts import steps
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.artefacts.response import axes_of, columns_of, probes_of
from thermojoint.models.assembly import deformation_bank
from thermojoint.models.filters.bank import Bank, respond_to_line, respond_to_steps, stacked
from thermojoint.models.filters.inverse import inverse_bank
from thermojoint.models.parameters import DeformationModel
from thermojoint.models.regularisation import choose_regularisation, steepest_rise

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Rule:
    """Bounds of the placement rule; docs/calibration.md gives the reasons."""

    #: Largest deviation of a difference from proportionality, and largest fall from its maximum,
    #: relative to its final value; doubled until a pair fulfils it.
    proportional: float = 1e-3
    #: Smallest final difference, relative to the largest.
    difference: float = 0.1
    #: Number of pairs that Eq. 2 is fitted to.
    shortlist: int = 60
    #: The larger the fraction of a difference reached at this share of the run, the faster the
    #: pair.
    early: float = 1 / 70
    #: K: the range of the paper's sensor noise. The sensors at the joint are chosen, and their
    #: sources are calibrated (`calibrate.chain`), for temperature deviations with this rms
    #: uncertainty.
    deviation_uncertainty: float = 0.12
    #: Sensors closer than this would see one source twice, relative to the extent of the
    #: candidates.
    apart: float = 0.25
    #: An axis with a nonlinear displacement below this fraction of the largest does not rank the
    #: sensors.
    faint_axis: float = 1e-3
    #: Tolerance of the rational approximations while pairs are compared.
    screening: float = 1e-5


#: The defaults.
RULE = Rule()


@dataclass(frozen=True)
class HeatPair:
    """A pair of sensors near the heat source."""

    #: Probe names; a is the warmer.
    a: str
    b: str
    #: T_a - T_b at the end of the reference step, K per unit of heat input.
    difference: float
    #: Largest deviation from proportionality over the calibration inputs, relative.
    disproportion: float
    #: Largest error of Eq. 2, relative to the difference.
    ring_error: float
    #: Time of the steepest rise of the fitted Eq. 2, s.
    rise_time: float
    #: Largest error of the estimated linear displacement over the calibration inputs, m.
    displacement_error: float


@dataclass(frozen=True)
class JointSensors:
    """Sensors near the joint, one for each fictitious source."""

    #: T1, T2 ...: probe names, from the lower end of the joint on.
    probes: tuple[str, ...]
    #: The smallest of their largest deviations at the calibration inputs, K.
    signal: float
    #: Rms nonlinear displacement left by the screening map, relative.
    misfit: float


@dataclass(frozen=True)
class Placement:
    """The chosen sensors and sources."""

    heat: HeatPair
    joint: JointSensors
    #: Shape (n, 3): positions of the fictitious sources, m.
    sources: Array
    #: Shape (n, n): r_ij from source i to sensor T_j, m.
    distances: Array

    @property
    def roles(self) -> dict[str, str]:
        """Role to probe name."""
        at_joint = {f"T{i}": name for i, name in enumerate(self.joint.probes, start=1)}
        return {"a": self.heat.a, "b": self.heat.b} | at_joint

    def __str__(self) -> str:
        """Lines for the terminal and the report."""
        h, j = self.heat, self.joint
        where = "; ".join(
            f"q{i + 1} at ({', '.join(f'{1e3 * x:.0f}' for x in point)}) mm"
            for i, point in enumerate(self.sources)
        )
        r = ", ".join(
            f"r{i + 1}{k + 1} = {100 * value:.2f} cm"
            for (i, k), value in np.ndenumerate(self.distances)
        )
        sensors = ", ".join(f"T{i} = {name}" for i, name in enumerate(j.probes, start=1))
        return (
            f"a = {h.a}, b = {h.b}: difference {h.difference:.2f} K, proportional within "
            f"{100 * h.disproportion:.3f} %, Eq. 2 within {100 * h.ring_error:.2f} %, steepest at "
            f"{h.rise_time:.0f} s, linear displacement within {1e6 * h.displacement_error:.2f} µm\n"
            f"{sensors}: deviations of {j.signal:.2f} K and more, screening map "
            f"leaves {100 * j.misfit:.0f} % of the nonlinear displacement\n{where}; {r}"
        )


def choose_heat_pair(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    deformation: Mapping[str, DeformationModel],
    candidates: list[str],
    rule: Rule = RULE,
) -> HeatPair:
    """Choose a and b.

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step; its level need not be 1.
    others : mapping
        Heat input to the response to it.
    deformation : mapping
        Eq. 8 of every relevant axis.
    candidates : list of str
        Probes to choose from.
    rule : Rule
        Bounds of the rule.

    Raises
    ------
    InputError
        No pair satisfies the rule.
    """
    t = steps.times(reference)
    interval = float(np.median(np.diff(t)))
    unit = steps.step_level(reference, "reference response")
    unit_responses = columns_of(reference, "temperature", candidates) / unit
    scaled = [
        columns_of(response, "temperature", candidates) / level
        for level, response in others.items()
    ]
    responses = np.stack([unit_responses, *scaled], axis=-1)
    levels = np.abs([unit, *others])
    linear = stacked([deformation_bank(model) for model in deformation.values()])
    size, off, early = (np.empty((len(candidates),) * 2) for _ in range(3))
    for i in range(len(candidates)):
        difference = unit_responses[:, [i]] - unit_responses
        size[i] = difference[-1]
        falls = np.maximum.accumulate(difference) - difference
        strays = [np.abs(s[:, [i]] - s - difference) for s in scaled]
        off[i] = np.max([falls, *strays], axis=(0, 1))
        early[i] = _at(t, difference, t[0] + rule.early * (t[-1] - t[0]))
    large = np.argwhere(size > max(rule.difference * size.max(initial=0.0), 0.0))
    bound = rule.proportional
    while bound < 1.0:
        good = [(i, j) for i, j in large if off[i, j] < bound * size[i, j]]
        good.sort(key=lambda pair: -early[pair] / size[pair])
        pairs: list[HeatPair] = []
        for i, j in good[: rule.shortlist]:
            try:
                ring, fit = fit_ring(
                    t, unit_responses[:, i] - unit_responses[:, j], starts=6, polished=1
                )
                f = choose_regularisation(ring, interval)
                inverse = inverse_bank(
                    [[ring]], [f], interval, float(t[-1]), rule.screening, "candidate pair"
                )
            except ThermojointError:
                continue  # no stable inverse: the pair is out
            differences = responses[:, i] - responses[:, j]
            error = float((_linear_errors(inverse, linear, t, differences) * levels).max())
            last = float(size[i, j])
            pairs.append(
                HeatPair(
                    candidates[i],
                    candidates[j],
                    last,
                    float(off[i, j]) / last,
                    fit.max_abs_error / last,
                    steepest_rise(ring)[0],
                    error,
                )
            )
        if pairs:
            return min(pairs, key=lambda pair: pair.displacement_error)
        bound *= 2.0
    raise InputError(
        "placement: no pair of candidates near the source has a difference that rises with the "
        "heat and can be inverted; give more [[candidates]] around the source"
    )


def rank_joint_sensors(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    candidates: list[str],
    count: int = 2,
) -> Iterator[JointSensors]:
    """Yield sets of `count` sensors T1, T2 ... in the order of the rule, best first.

    Parameters
    ----------
    reference, others, candidates
        As in `choose_heat_pair`; the displacement along every axis of the reference counts.
    count : int
        Number of sensors, and of fictitious sources.

    Raises
    ------
    InputError
        The displacement is proportional to the heat input.
    """
    t = steps.times(reference)
    axes = axes_of(reference)
    at = _positions(reference, candidates)
    unit = steps.step_level(reference, "reference response")
    base = columns_of(reference, "temperature", candidates) / unit
    moved = columns_of(reference, "displacement", axes) / unit
    deviations = [columns_of(r, "temperature", candidates) - q * base for q, r in others.items()]
    targets = [columns_of(r, "displacement", axes) - q * moved for q, r in others.items()]
    signals = np.max([np.abs(d).max(axis=0) for d in deviations], axis=0)
    features = np.concatenate([_filtered(d, t) for d in deviations])
    target = np.concatenate(targets)
    power = (target**2).sum(axis=0)
    if not power.any():
        raise InputError(
            "placement: the displacement is proportional to the heat input; no joint acts on it"
        )
    counts = power > RULE.faint_axis**2 * power.max()
    gram = features.T @ features
    drive = features.T @ target
    wide = len(UNCERTAIN)
    ridge = len(target) * RULE.deviation_uncertainty**2 * np.eye(count * wide)
    extent = np.ptp(at, axis=0)
    apart = (1.0 - 1e-9) * RULE.apart * extent.max()
    order: list[tuple[bool, float, tuple[int, ...]]] = []
    for chosen in combinations(range(len(candidates)), count):
        own_at = at[list(chosen)]
        if any(np.linalg.norm(x - y) < apart for x, y in combinations(own_at, 2)):
            continue
        faint = bool(signals[list(chosen)].min() < RULE.deviation_uncertainty)
        own = np.concatenate([np.arange(wide * i, wide * (i + 1)) for i in chosen])
        inner = gram[np.ix_(own, own)]
        weights = np.linalg.solve(inner + ridge, drive[own])
        left = power - 2.0 * (weights * drive[own]).sum(0) + (weights * (inner @ weights)).sum(0)
        order.append((faint, float(np.sqrt((left[counts] / power[counts]).max())), chosen))
    order.sort()
    # Along the joint is the direction in which the candidates spread most.
    along = at[:, int(np.argmax(extent))]
    for _, misfit, chosen in order:
        lowest_first = sorted(chosen, key=lambda i: along[i])
        names = tuple(candidates[i] for i in lowest_first)
        yield JointSensors(names, float(signals[list(chosen)].min()), misfit)


def sources_for(response: xr.Dataset, probes: Sequence[str]) -> tuple[Array, Array]:
    """Positions of the fictitious sources (n, 3) and distances r_ij (n, n), m.

    Source i lies at the centre of the contact element nearest to T_i.

    Parameters
    ----------
    response : xarray.Dataset
        With ``probe_position`` and ``contact_position``.
    probes : sequence of str
        The probes that serve as T1, T2 ...

    Raises
    ------
    InputError
        The response has no contact elements.
    """
    if "contact_position" not in response or not response["contact_position"].size:
        raise InputError(
            "calibration responses, reference: no contact elements to put the fictitious sources "
            "at; name the sensors and give their distances r_ij (--distances-mm)"
        )
    sensors = _positions(response, list(probes))
    elements = response["contact_position"].to_numpy()
    nearest = [int(np.argmin(np.linalg.norm(elements - x, axis=1))) for x in sensors]
    sources = elements[nearest]
    return sources, np.linalg.norm(sources[:, None] - sensors[None], axis=2)


def with_roles(response: xr.Dataset, roles: Mapping[str, str]) -> xr.Dataset:
    """Return the response with the probes duplicated under the names of their roles."""
    chosen = response.sel(probe=list(roles.values())).assign_coords(probe=list(roles))
    kept = response.sel(probe=[name for name in probes_of(response) if name not in roles])
    import xarray as xr

    joined = xr.concat(
        [chosen[["temperature", "probe_position"]], kept[["temperature", "probe_position"]]],
        dim="probe",
    )
    return response.drop_dims("probe").merge(joined).assign_attrs(response.attrs)


def _at(t: Array, values: Array, time: float) -> Array:
    """Values (n, m), sampled at times t (n,), at one time; straight lines between samples."""
    k = min(max(int(np.searchsorted(t, time)), 1), len(t) - 1)
    part = min((time - t[k - 1]) / (t[k] - t[k - 1]), 1.0)
    return np.asarray((1.0 - part) * values[k - 1] + part * values[k])


def _linear_errors(inverse: Bank, linear: Bank, t: Array, differences: Array) -> Array:
    """Largest errors of δ_L, m, for unit steps with responses (n, runs), K per unit."""
    interval = float(np.median(np.diff(t)))
    heat = respond_to_line(inverse, t, differences[:, None], interval)[0]
    error = respond_to_steps(linear, t, heat - (t > 0.0)[:, None, None], interval)
    return np.abs(error).max(axis=(0, 1))


def _filtered(deviations: Array, t: Array) -> Array:
    """Deviations (n, sensors) after each low-pass filter, shape (n, sensors * filters)."""
    from scipy.signal import lfilter

    interval, length = float(np.median(np.diff(t))), float(t[-1] - t[0])
    columns = []
    for share in UNCERTAIN:
        pole = np.exp(-interval / (share * length))
        columns.append(lfilter([1.0 - pole], [1.0, -pole], deviations, axis=0))
    return np.stack(columns, axis=-1).reshape(len(deviations), -1)


def _positions(response: xr.Dataset, probes: list[str]) -> Array:
    return np.asarray(response["probe_position"].sel(probe=probes).to_numpy())
