"""Summary figures of a response: one row of a batch's table."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.units import MEGA, MICRO

if TYPE_CHECKING:
    from thermojoint.artefacts.response import AnyResponse

Figures = dict[str, float]

#: A contact element below this fraction of its preload is open. Not zero: the pressure of rough
#: surfaces decays but never vanishes.
OPEN_BELOW = 1e-3
#: A contact element slides if its slip changes by more than this in a step, m. Not zero: without
#: friction an element at rest creeps within the tolerance of the gap equations.
SLIDES_ABOVE = 1e-12

#: Summary values of a quantity over time, with descriptions.
KINDS = {"peak": "largest in magnitude, with its sign", "final": "at the end"}

#: From column to its description; the columns of every summary, in this order.
FIGURES = {
    **{f"displacement_{axis}_{kind}_um": text for axis in "xyz" for kind, text in KINDS.items()},
    "pressure_min_MPa": "lowest contact pressure of the run",
    "pressure_max_MPa": "highest contact pressure of the run",
    "open_share_peak": "largest share of the joints' area below 1e-3 of its preload",
    "open_share_final": "the same at the end",
    "sliding_share_peak": "largest share of the joints' area that slides in a step",
    "sliding_share_final": "the same in the last step",
    "temperature_max_K": "highest temperature of a probe above the initial ambient",
    "gap_residual_m": "largest residual of the gap equations",
    "heat_balance": "largest error of the heat balance, relative",
    "bolt_force_min_N": "lowest force of a bolt",
    "bolt_force_max_N": "highest force of a bolt",
    "force_balance": "largest error of the balance of supports and loads, relative",
    "secant_residual_K": "largest change of a temperature in a last secant step, K",
    "steps": "time steps",
    "iterations": "Newton iterations",
    "cuts": "viscous steps where a joint snapped",
    "taken_over": "steps iterated because staggered ones alternate",
    "unresolved_steps": "steps whose pressures alternate although no input does",
}
#: Figures of a displacement over the stroke of a moving axis: from word to unit of the column and
#: description.
OVER_STROKE = {
    "K0": ("um", "K0: the line over the stroke of {}, at P0"),
    "slope": ("um_per_m", "tan beta: the slope of that line"),
    "left": ("um", "what that line leaves at most"),
    "asked": ("um", "where it is largest, of the positions of {} asked about"),
}
#: Integer columns.
COUNTS = ("steps", "iterations", "cuts", "taken_over", "unresolved_steps")


def columns(moving_axes: Iterable[str]) -> dict[str, str]:
    """Return the columns of a summary and their descriptions: `FIGURES`, and those along axes.

    Parameters
    ----------
    moving_axes : iterable of str
        Names of the moving axes of the cases.
    """
    along = {
        _column(axis, word, moving, kind): f"{text.format(moving)}, {when}"
        for moving in moving_axes
        for axis in "xyz"
        for word, (_, text) in OVER_STROKE.items()
        for kind, when in KINDS.items()
    }
    return FIGURES | along


def _column(axis: str, word: str, moving: str, kind: str) -> str:
    return f"displacement_{axis}_{word}_{moving}_{kind}_{OVER_STROKE[word][0]}"


def is_open(
    pressure: NDArray[np.float64], preload: NDArray[np.float64] | None = None
) -> NDArray[np.bool_]:
    """Return which contact elements are open at each time: below `OPEN_BELOW` of their preload.

    Parameters
    ----------
    pressure : ndarray, shape (time, contact)
        Contact pressures of a simulated response, Pa.
    preload : ndarray, shape (contact,), optional
        Preloads, Pa; default the first row, unless the run was continued from a saved state.
    """
    return pressure < OPEN_BELOW * (pressure[0] if preload is None else preload)


def is_sliding(slip: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which contact elements slide in each step: their slip changes by `SLIDES_ABOVE`.

    Parameters
    ----------
    slip : ndarray, shape (time, contact, 2)
        Slip in a simulated response, m.

    Returns
    -------
    ndarray of bool, shape (time - 1, contact)
        For the step that ends with each sample but the first.
    """
    return np.linalg.norm(np.diff(slip, axis=0), axis=2) > SLIDES_ABOVE


def preloads(response: AnyResponse) -> NDArray[np.float64]:
    """Return the preload of every contact element, Pa, from the case in a response.

    For a joint without preload it is the reference pressure.
    """
    joints = json.loads(response.attrs["case"])["joints"]
    each = {
        name: MEGA * (joint["preload_MPa"] or joint["reference_pressure_MPa"])
        for name, joint in joints.items()
    }
    return np.array([each[str(name)] for name in response["contact_joint"].to_numpy()])


def largest(values: NDArray[np.float64]) -> float:
    """Return the value of largest magnitude, with its sign."""
    return float(values.flat[np.abs(values).argmax()])


def _over_strokes(response: AnyResponse) -> Figures:
    """Figures of every displacement over the stroke of every moving axis, µm and µm/m."""
    asked = response["asked_displacement"].to_numpy()
    # Each by time, moving axis and axis; only requested displacements have several positions.
    tracks = {
        "K0": response["line_offset"].to_numpy()[:, :, None],
        "slope": response["line_slope"].to_numpy()[:, :, None],
        "left": response["line_left"].to_numpy()[:, :, None],
        "asked": asked,
    }
    return {
        _column(str(axis), word, str(moving), kind): MEGA * largest(tracks[word][when, m, :, c])
        for m, moving in enumerate(response["moving_axis"].to_numpy())
        for c, axis in enumerate(response["axis"].to_numpy())
        for word in OVER_STROKE
        for kind, when in (("peak", slice(None)), ("final", slice(-1, None)))
    }


def taken_steps(response: AnyResponse) -> int:
    """Return the number of steps of the march, which in an adaptive one differs from the times."""
    taken = int(np.count_nonzero(response["time"].to_numpy() > 0.0))
    return int(response.attrs.get("march_steps", taken))


def figures_of(response: AnyResponse) -> Figures:
    """Return the figures of a simulated response, with the names of `columns`.

    Those of contact elements are missing if a structure has none.
    """
    figures: Figures = {}
    displacement = MEGA * response["displacement"].to_numpy()
    for axis, track in zip(response["axis"].to_numpy(), displacement.T, strict=True):
        figures[f"displacement_{axis}_peak_um"] = largest(track)
        figures[f"displacement_{axis}_final_um"] = float(track[-1])
    if "line_offset" in response:
        figures |= _over_strokes(response)
    pressure = response["pressure"].to_numpy()
    if pressure.shape[1]:
        area = response["contact_area"].to_numpy()
        parted = is_open(pressure, preloads(response))
        sliding = is_sliding(response["slip"].to_numpy()) & ~parted[1:]
        opened, slid = (which @ area / area.sum() for which in (parted, sliding))
        figures["pressure_min_MPa"] = MICRO * float(pressure.min())
        figures["pressure_max_MPa"] = MICRO * float(pressure.max())
        figures["open_share_peak"] = float(opened.max())
        figures["open_share_final"] = float(opened[-1])
        figures["sliding_share_peak"] = float(slid.max())
        figures["sliding_share_final"] = float(slid[-1])
    figures["temperature_max_K"] = float(response["temperature"].to_numpy().max())
    figures["gap_residual_m"] = float(response["gap_residual"].to_numpy().max())
    figures["heat_balance"] = float(np.abs(response["heat_balance"].to_numpy()).max())
    if "bolt_force" in response:
        figures["bolt_force_min_N"] = float(response["bolt_force"].to_numpy().min())
        figures["bolt_force_max_N"] = float(response["bolt_force"].to_numpy().max())
    if "secant_residual" in response:
        figures["secant_residual_K"] = float(response["secant_residual"].to_numpy().max())
    if "force_balance" in response:
        figures["force_balance"] = float(response["force_balance"].to_numpy().max())
    figures["steps"] = taken_steps(response)
    figures["iterations"] = int(response["iterations"].to_numpy().sum())
    for name in ("cuts", "taken_over"):
        figures[name] = int(response[name].to_numpy().sum()) if name in response else 0
    figures["unresolved_steps"] = int(response.attrs.get("unresolved_steps", 0))
    return figures
