"""Observables of the paper's machine, evaluated from simulated responses.

Nothing here knows an estimator: a machine is judged by its own responses alone. Where the paper's
points T1 and T2 are concerned, the probes e1 ... e9 along a strip stand in for them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimator.superposition import superposed
from thermojoint.artefacts.response import probes_of
from thermojoint.models.deformation import basis
from thermojoint.paper import paper_values
from thermojoint.paper.summary import pressure_share

Vector = NDArray[np.float64]

#: The plane of the machine: z is across its symmetry plane, where nothing moves.
AXES = ("x", "y")
#: The probe at the contact element that carries the paper's T2.
TOP = "e9"
#: Steadiness is read off the end of the run, s.
LATE = 300.0


def observables_of(responses: Mapping[str, xr.Dataset]) -> dict[str, float]:
    """Return every observable of one machine by its name.

    `responses`: ``0.5``, ``1.0``, ``2.0``, ``3.0`` (steps of that heat input, as text) and
    ``triangle``, with the probes e1 ... e9. Returns µm, K, s and ratios as the names in
    `benchmarks.reference_machine.score.STATEMENTS`; NaN where a machine has no such value.
    """
    reference, steep, triangle = responses["1.0"], responses["3.0"], responses["triangle"]
    final = {level: 1e6 * plane(responses[level])[-1] for level in ("0.5", "1.0", "2.0", "3.0")}
    nonlinear = {level: total - float(level) * final["1.0"] for level, total in final.items()}
    hot, warm = deviation(reference, steep), deviation(reference, triangle)
    top = probes_of(triangle).index(TOP)
    shares = pressure_shares(responses["2.0"])
    times = reference["time"].to_numpy()
    curve = plane(responses["2.0"]) - 2.0 * plane(reference)
    return {
        "total_um": float(np.abs(final["3.0"]).max()),
        "nonlinear_um": float(np.abs(nonlinear["3.0"]).max()),
        "ratio_half": strength(nonlinear["0.5"], nonlinear["2.0"]),
        "ratio_three": strength(nonlinear["3.0"], nonlinear["2.0"]),
        "deviation_K": float(np.abs(hot).max()),
        "triangle_K": float(np.abs(warm).max()),
        "triangle_top_K": float(np.abs(warm[:, top]).max()),
        "pressure_share": float(np.median(shares)) if shares.size else np.nan,
        "pressure_least": float(shares.min()) if shares.size else np.nan,
        "late_change": late_change(times, plane(reference)),
        "half_time_s": half_time(times, plane(reference)),
        "nonlinear_half_time_s": half_time(times, curve),
        "from_vertical_deg": from_vertical(final["1.0"]),
        "nonlinear_from_vertical_deg": from_vertical(nonlinear["2.0"]),
        **{f"total_{axis}_um": float(final["3.0"][k]) for k, axis in enumerate(AXES)},
        **{f"nonlinear_{axis}_um": float(nonlinear["3.0"][k]) for k, axis in enumerate(AXES)},
    }


def plane(response: xr.Dataset) -> Vector:
    """Return the displacement along `AXES`, m, shape (n, 2)."""
    return response["displacement"].sel(axis=list(AXES)).to_numpy()


def deviation(reference: xr.Dataset, response: xr.Dataset) -> Vector:
    """Return what the temperatures are above the superposed reference, K, shape (n, probes)."""
    return response["temperature"].to_numpy() - superposed(reference, response, "temperature")


def strength(vector: Vector, unit: Vector) -> float:
    """Return the factor q for which q `unit` is nearest to `vector`; NaN if `unit` is zero.

    So both axes count, each by its size: q is what a fictitious source's strength is in Eq. 18.
    """
    square = float(unit @ unit)
    return float(vector @ unit) / square if square > 0.0 else np.nan


def pressure_shares(response: xr.Dataset) -> Vector:
    """Return which share of its final rise each contact pressure has made after one minute.

    Only of the elements whose pressure rises (the paper's "under compressive stresses").

    Returns negative where the pressure falls first. Empty if no pressure rises.
    """
    rows = pressure_share(response).rows
    return np.array([row.share for row in rows if row.share is not None and row.final_MPa > 0.0])


def late_change(times: Vector, displacement: Vector) -> float:
    """Return which part of the final displacement (length) came in the last five minutes."""
    before = int(np.searchsorted(times, times[-1] - LATE))
    moved = np.linalg.norm(displacement[-1] - displacement[before])
    return float(moved / np.linalg.norm(displacement[-1]))


def half_time(times: Vector, displacement: Vector) -> float:
    """Return when half of the final displacement is reached along its own direction, s.

    NaN if there is none at the end.
    """
    if not displacement[-1].any():
        return np.nan
    along = displacement @ displacement[-1] / float(displacement[-1] @ displacement[-1])
    after = int(np.argmax(along >= 0.5))
    if after == 0:
        return float(times[0])
    low, high = along[after - 1], along[after]
    return float(times[after - 1] + (times[after] - times[after - 1]) * (0.5 - low) / (high - low))


def from_vertical(vector: Vector) -> float:
    """Return the angle between the vertical and (x, y), degrees, 0 to 90: its sign does not count.

    The paper subtracts the actual from the linear temperatures in one place and the other way
    round in another, so the sign of its nonlinear part is open.
    """
    return float(np.degrees(np.arctan2(abs(vector[0]), abs(vector[1]))))


def printed_displacement(times: Vector) -> Vector:
    """Return Table 1's Eq. 8 at heat input 1, in the table's own unit, shape (n, 2)."""
    return np.stack([_curve(paper_values.TABLE1_DEFORMATION[axis], times) for axis in AXES], axis=1)


def printed_nonlinear(times: Vector) -> Vector:
    """Return Tables 2 and 3's Eq. 18 at heat input 2, in the table's own unit, shape (n, 2)."""
    strengths = [source["q 2.0"] for source in paper_values.TABLE2]
    return np.stack(
        [
            sum(
                q * _curve(source, times)
                for q, source in zip(strengths, paper_values.TABLE3[axis], strict=True)
            )
            for axis in AXES
        ],
        axis=1,
    )


def _curve(parameters: Mapping[str, float], times: Vector) -> Vector:
    amplitudes = [value for name, value in parameters.items() if name.isupper()]
    rates = [value for name, value in parameters.items() if name.islower()]
    return basis(times, rates)[0] @ np.array(amplitudes)
