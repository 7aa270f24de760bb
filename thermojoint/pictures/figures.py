"""Matplotlib figures after the paper's Figures 7-11, as pure functions of the data.

Time is in minutes, temperature in K, displacement in µm, pressure in MPa. Curves differ in line
style as well as in shade, so that they can be distinguished in grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.figures import WIDTH
from thermojoint.artefacts.files import whole_file

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


_STYLES = (
    "-",
    "--",
    "-.",
    ":",
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (1, 1)),
    (0, (8, 2)),
    (0, (3, 1, 1, 1)),
)
_SHADES = ("#000000", "#b2341f", "#1f5fa8", "#3c7d3c", "#8a5a00", "#6b4c9a", "#1b8a8f", "#c04a8c")
_NOISY_WIDTH = 0.4
#: Formats of figures of curves.
FORMATS = ("png", "svg", "pdf")
#: Estimators that are always drawn with the actual displacement.
OWN = ("fchs", "joint-aware")
#: Largest number of places along a joint that are numbered.
LABELLED = 12


def pressure_figure(response: xr.Dataset) -> Figure:
    """Figure 7: change of the contact pressure along the joint; positive where it grows.

    Contact elements at the same place along a joint are averaged by area, and numbered from the
    joint's lower end, joint after joint. The paper plots compression downwards.

    Raises
    ------
    InputError
        There is no pressure: the response is measured, or the structure has no joints.
    """
    if "pressure" not in response:
        raise InputError("response: variable 'pressure' is missing; give a simulated response")
    if not response["pressure"].size:
        raise InputError("response: no joints, so no contact pressure; use --show curves")
    minutes = response["time"].to_numpy() / 60.0
    pressure = pressure_along(response) / 1e6
    change = pressure - pressure[0]
    numbers = range(1, pressure.shape[1] + 1)
    figure, axes = _figure(1)
    labelled = len(numbers) <= LABELLED
    for k, number in enumerate(numbers):
        axes[0].plot(
            minutes,
            change[:, k],
            linestyle=_STYLES[k % len(_STYLES)],
            # One shade fewer than styles, so that no pair repeats among fifty curves.
            color=_SHADES[k % (len(_SHADES) - 1)],
            linewidth=1.3,
            label=f"element {number}" if labelled else None,
        )
    if labelled:
        _name_ends(axes[0], minutes[-1], change[-1], [str(number) for number in numbers])
    most = f"{float(response['pressure'].isel(time=0).max()) / 1e6:.2f} MPa"
    # A response that continues a saved state does not contain the preload.
    of_all = "up to " if len({*joints_of(response)}) > 1 else ""
    before = f"at first up to {most}" if minutes[0] > 0.0 else f"preload {of_all}{most}"
    figure.suptitle(f"{heat_text(response)}, {before}", fontsize=10)
    axes[0].set_ylabel("change of contact pressure (MPa)")
    _finish(axes, legend=False)
    if labelled:
        names = axes[0].get_legend_handles_labels()
        figure.legend(*names, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def pressure_along(response: xr.Dataset) -> Array:
    """Mean contact pressure at each place along each joint, Pa, shape (times, places).

    Without the positions of the contact elements every element is a separate place.
    """
    pressure = response["pressure"].to_numpy()
    if "contact_position" not in response:
        return np.asarray(pressure)
    position = response["contact_position"].to_numpy()
    place = places_along(position, joints_of(response))
    area = response["contact_area"].to_numpy()
    share = np.zeros((place.size, int(place.max()) + 1))
    share[np.arange(place.size), place] = area
    return np.asarray(pressure @ (share / share.sum(axis=0)))


def joints_of(response: xr.Dataset) -> list[str]:
    """Return the joint of every contact element; the same where a response does not say it."""
    if "contact_joint" not in response:
        return [""] * response.sizes["contact"]
    return [str(name) for name in response["contact_joint"].to_numpy()]


def places_along(position: Array, joints: Sequence[str]) -> NDArray[np.int64]:
    """Number the contact elements by their place along their joint, from 0, joint after joint.

    That is along the joint's largest extent. `position` has shape (elements, 3), m; `joints` names
    the joint of every element.
    """
    places, count = np.zeros(len(position), dtype=np.int64), 0
    for joint in dict.fromkeys(joints):
        own = np.array([name == joint for name in joints])
        along = position[own][:, np.argmax(np.ptp(position[own], axis=0))]
        numbers = np.unique(np.round(along, 6), return_inverse=True)[1]
        places[own] = count + numbers
        count += int(numbers.max()) + 1
    return places


def heat_text(response: xr.Dataset) -> str:
    """Return the heat input of a response in words, with the total power if it was simulated."""
    heat = response["heat_input"].to_numpy()
    at = int(np.abs(heat).argmax())
    steady = bool(np.allclose(heat[1:], heat[at], rtol=1e-6, atol=0.0))
    text = f"heat input {'' if steady else 'up to '}{heat[at]:g}"
    if "source_power" not in response or not response["source_power"].size:
        return text
    return f"{text} ({float(response['source_power'][at].sum()):.4g} W)"


#: Factor from SI and label of a panel: Figures 8 and 10 for each sensor, 9 and 11 for each axis.
DEVIATION, NONLINEAR = (1.0, "deviation at {} (K)"), (1e6, "nonlinear displacement {} (µm)")


def panels_figure(
    times: Array, curves: Mapping[str, Mapping[str, Array]], heat: str, unit: float, label: str
) -> Figure:
    """Figures 8 to 11: curves over time (s, shape (k,)), one panel for each sensor or axis.

    `curves` maps it to {label: deviation in K or nonlinear displacement in m, shape (k,)}; `unit`
    and `label` are `DEVIATION` or `NONLINEAR`, `heat` is the heat input in words (`heat_text`).
    """
    figure, axes = _figure(len(curves))
    figure.suptitle(heat, fontsize=10)
    for axis, (name, series) in zip(axes, curves.items(), strict=True):
        _draw(axis, times, series, unit)
        axis.set_ylabel(label.format(name))
    _finish(axes)
    return figure


def estimates_figure(
    times: Array, errors: Mapping[str, Array], axes: Sequence[str], case: str
) -> Figure:
    """Actual and estimated displacement of each axis, and the errors below on their own scale.

    FCHS, the joint-aware estimator, and the best of the others are drawn; more curves would hide
    each other.

    `times` has shape (k,), s. `errors` maps each estimator to estimated minus actual displacement,
    m, shape (k, axes). The actual displacement follows from ``none``, which always estimates zero.
    """
    shown = [name for name in OWN if name in errors]
    others = [name for name in errors if name not in (*OWN, "none")]
    if others:
        shown.append(min(others, key=lambda name: float(np.mean(errors[name] ** 2))))
    figure, panels = _figure(2 * len(axes))
    figure.suptitle(case, fontsize=11)
    for k, axis in enumerate(axes):
        actual = -errors["none"][:, k]
        estimated = {name: actual + errors[name][:, k] for name in shown}
        wrong = {name: errors[name][:, k] for name in shown}
        above, below = panels[2 * k : 2 * k + 2]
        _draw(above, times, {"actual": actual} | estimated, 1e6)
        # The colours of the panel above.
        _draw(below, times, {"actual": np.full_like(actual, np.nan)} | wrong, 1e6)
        above.set_ylabel(f"{axis} (µm)")
        below.set_ylabel(f"error {axis} (µm)")
    _finish(panels, legend=False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def response_figure(response: xr.Dataset) -> Figure:
    """Overview of one response: heat input, temperatures of eight probes, displacements if any."""
    times, names = response["time"].to_numpy(), [str(name) for name in response["axis"].to_numpy()]
    figure, axes = _figure(3 if names else 2)
    figure.suptitle(heat_text(response), fontsize=10)
    _draw(axes[0], times, {"heat input": response["heat_input"].to_numpy()}, 1.0)
    axes[0].set_ylabel("heat input (reference = 1)")
    probes = [str(name) for name in response["probe"].to_numpy()][: len(_STYLES)]
    temperature = response["temperature"].to_numpy()
    _draw(axes[1], times, {name: temperature[:, k] for k, name in enumerate(probes)}, 1.0)
    axes[1].set_ylabel("temperature above the initial ambient (K)")
    if names:
        displacement = response["displacement"].to_numpy()
        _draw(axes[2], times, {name: displacement[:, k] for k, name in enumerate(names)}, 1e6)
        axes[2].set_ylabel("displacement (µm)")
    _finish(axes)
    return figure


def write_figure(figure: Figure, path: Path, dpi: float = 150) -> None:
    """Write `figure` to `path`, whole or not at all; the suffix is the format (`check_format`)."""
    suffix = check_format(path)
    with whole_file(Path(path)) as part:
        figure.savefig(part, dpi=dpi, format=suffix)


def check_format(path: Path) -> str:
    """Return the format of the suffix of `path` (.png, .svg, .pdf).

    Raises
    ------
    InputError
        The suffix is none of `FORMATS`.
    """
    suffix = Path(path).suffix.lstrip(".").lower()
    if suffix not in FORMATS:
        raise InputError(f"{path}: no picture format {suffix!r}; use .png, .svg or .pdf")
    return suffix


def check_png(path: Path) -> None:
    """Refuse a file name that does not end in ``.png``.

    Raises
    ------
    InputError
        The suffix is not ``.png``.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: 3-D pictures are PNG files; name it {path.stem}.png")


def _figure(panels: int) -> tuple[Figure, list[Axes]]:
    """Return an empty figure with `panels` panels one above the other."""
    figure = empty_grid(panels, 1, (WIDTH, 0.5 + 2.8 * panels))
    return figure, figure.axes


def empty_grid(rows: int, columns: int, size: tuple[float, float]) -> Figure:
    """Return an empty figure of rows of panels, `size` in inches, without pyplot's global state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    figure.subplots(rows, columns, squeeze=False)
    return figure


def _draw(axis: Axes, times: Array, series: Mapping[str, Array], factor: float) -> None:
    for k, (label, values) in enumerate(series.items()):
        axis.plot(
            times / 60.0,
            factor * values,
            linestyle=_STYLES[k % len(_STYLES)],
            color=_SHADES[k % len(_SHADES)],
            linewidth=_NOISY_WIDTH if _is_noisy(values) else 1.2,
            label=label,
        )


def mark_alone(curve: Line2D) -> None:
    """Mark the points of a curve between missing ones: no line leads to them."""
    there = np.pad(np.isfinite(np.asarray(curve.get_ydata())), 1)
    alone = np.flatnonzero(there[1:-1] & ~there[:-2] & ~there[2:])
    curve.set(marker=".", markersize=4.0, markevery=alone.tolist())


def _is_noisy(values: Array) -> bool:
    """Whether a curve changes direction so often that a thick line would be a black band."""
    turns = np.diff(np.sign(np.diff(values)))
    return bool(np.count_nonzero(turns) > 0.3 * max(turns.size, 1))


def _name_ends(axis: Axes, end: float, values: Array, names: list[str]) -> None:
    """Write names at the ends of curves without overlaps."""
    order = np.argsort(values)
    apart = 0.035 * float(np.ptp(axis.get_ylim()))
    lowest = -np.inf
    for k in order:
        lowest = max(float(values[k]), lowest + apart)
        axis.text(end, lowest, f" {names[k]}", fontsize=8, va="center")


def _finish(axes: list[Axes], legend: bool = True) -> None:
    for axis in axes:
        axis.set_xlabel("time (min)")
        axis.grid(visible=True, color="0.88", linewidth=0.6)
        axis.axhline(0.0, color="0.5", linewidth=0.6)
        axis.margins(x=0.04)
        if legend:
            axis.legend(fontsize=8)
