"""What one response comes to: the figures of a row of a batch's summary."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

Figures = dict[str, float]

#: A contact element with less than this share of its preload is open. Not zero: the pressure of
#: rough surfaces fades without end.
OPEN_BELOW = 1e-3

#: Column to what it says; the columns of every summary, in this order.
FIGURES = {
    **{
        f"displacement_{axis}_{kind}_um": text
        for axis in "xyz"
        for kind, text in (("peak", "largest in magnitude, with its sign"), ("final", "at the end"))
    },
    "pressure_min_MPa": "lowest contact pressure of the run",
    "pressure_max_MPa": "highest contact pressure of the run",
    "open_share_peak": "largest share of the joints' area below 1e-3 of its preload",
    "open_share_final": "the same at the end",
    "temperature_max_K": "highest temperature of a probe above the initial ambient",
    "gap_residual_m": "largest residual of the gap equations",
    "heat_balance": "largest error of the heat balance, relative",
    "steps": "time steps",
    "iterations": "Newton iterations",
    "cuts": "how often a step was cut",
}
#: The whole numbers among them.
COUNTS = ("steps", "iterations", "cuts")


def is_open(pressure: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which contact elements are open when: under `OPEN_BELOW` of their preload.

    Parameters
    ----------
    pressure : ndarray, shape (time, contact)
        Of a simulated response, Pa; its first row is the preload.
    """
    return pressure < OPEN_BELOW * pressure[0]


def figures_of(response: xr.Dataset) -> Figures:
    """Return the figures of a simulated response, by the names of `FIGURES`.

    Those of the contact elements are missing where a structure has none.
    """
    figures: Figures = {}
    for axis in "xyz":
        track = 1e6 * response["displacement"].sel(axis=axis).to_numpy()
        figures[f"displacement_{axis}_peak_um"] = float(track[np.abs(track).argmax()])
        figures[f"displacement_{axis}_final_um"] = float(track[-1])
    pressure = response["pressure"].to_numpy()
    if pressure.shape[1]:
        area = response["contact_area"].to_numpy()
        opened = is_open(pressure) @ area / area.sum()
        figures["pressure_min_MPa"] = 1e-6 * float(pressure.min())
        figures["pressure_max_MPa"] = 1e-6 * float(pressure.max())
        figures["open_share_peak"] = float(opened.max())
        figures["open_share_final"] = float(opened[-1])
    figures["temperature_max_K"] = float(response["temperature"].max())
    figures["gap_residual_m"] = float(response["gap_residual"].max())
    figures["heat_balance"] = float(np.abs(response["heat_balance"]).max())
    figures["steps"] = response.sizes["time"] - 1
    figures["iterations"] = int(response["iterations"].sum())
    figures["cuts"] = int(response["cuts"].sum())
    return figures
