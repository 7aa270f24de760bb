"""Page of a finished batch: varied values and results, as tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from fesim.batch.study import Study
from fesim.batch.summary import COUNTS
from thermojoint.artefacts.figures import svg_address
from thermojoint.artefacts.templates import templates_of
from thermojoint.artefacts.units import MEGA
from thermojoint.pictures.study_figures import fan_figure, map_figure, pair_figure, strongest

if TYPE_CHECKING:
    import xarray as xr

#: Largest numbers of values and figures in the picture of all pairs, and of listed failures.
MOST_VALUES, MOST_FIGURES, MOST_FAILED = 4, 2, 20
#: Smaller differences, in the unit of a column, are rounding errors.
STILL = 1e-9
#: Quantiles in the table of figures.
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
#: Figures of the solver, not of the machine.
_SOLVER = {"gap_residual_m", "heat_balance", "force_balance", "secant_residual_K", *COUNTS}


def study_html(study: Study, summary: pd.DataFrame, dataset: xr.Dataset) -> str:
    """Return the page of a batch, without references to other files.

    The summary is that of `fesim.batch.run.Finished`, the dataset its ``dataset.zarr``.
    """
    is_done = summary["status"] == "done"
    done, failed = summary[is_done], summary[~is_done]
    paths = [path for path in study.paths if _varies(done, path)]
    table = figure_rows(done, study.columns)
    figures = [name for name, *_ in table if _varies(done, name)]
    return (
        templates_of("thermojoint.pictures")
        .get_template("study.html.j2")
        .render(
            title=study.title,
            generator="batch",
            counts=summary["status"].value_counts().to_dict(),
            values=[(path, _described(summary, path)) for path in study.paths],
            quantiles=QUANTILES,
            table=table,
            pictures=_pictures(done, dataset, paths, figures),
            failed=failed[["id", "reason"]].head(MOST_FAILED).to_numpy().tolist(),
            missing=len(failed),
        )
    )


def figure_rows(
    done: pd.DataFrame, columns: Mapping[str, str]
) -> list[tuple[str, str, list[float]]]:
    """Return name, meaning and `QUANTILES` of every figure present in some case.

    `done` are the summary's rows of finished cases, `columns` its figures and their meanings
    (`Study.columns`).
    """
    there = [name for name in columns if name not in _SOLVER and name in done]
    numbers = done[there].apply(pd.to_numeric, errors="coerce")
    return [
        (name, columns[name], numbers[name].quantile(QUANTILES).tolist())
        for name in there
        if numbers[name].notna().any()
    ]


def _varies(done: pd.DataFrame, name: str) -> bool:
    """Whether a column exists, is numeric in every case, and is not constant."""
    if name not in done or done[name].dtype.kind not in "if":
        return False
    values = done[name].to_numpy(dtype=np.float64)
    return bool(values.size and np.isfinite(values).all() and np.ptp(values) > STILL)


def _described(cases: pd.DataFrame, path: str) -> str:
    """Describe the values of a path: a single value, a range, or the number of different ones."""
    if _varies(cases, path):
        return f"{cases[path].min():.4g} to {cases[path].max():.4g}"
    if cases[path].nunique() == 1:
        return str(cases[path].dropna().iloc[0])
    return f"{cases[path].nunique()} different"


def _pictures(
    done: pd.DataFrame, dataset: xr.Dataset, paths: list[str], figures: list[str]
) -> list[tuple[str, str]]:
    """Return titles and addresses of the pictures."""
    drawn = []
    minutes = dataset["time"].to_numpy() / 60.0
    for axis in dataset["axis"].to_numpy():
        curves = MEGA * dataset["displacement"].sel(axis=axis).to_numpy()
        if np.isfinite(curves).any() and np.nanmax(np.abs(curves)) > STILL:
            title = f"Displacement along {axis}"
            drawn.append((title, fan_figure(minutes, curves, f"{axis} (µm)")))
    # One figure per axis: the peak of a warm-up is its final value.
    judged = ([name for name in figures if "final" in name] or figures)[:MOST_FIGURES]
    if paths and judged:
        pairs = [*strongest(done, paths, judged[0])[:MOST_VALUES], *judged]
        drawn.append(("Every pair of values and figures", pair_figure(done[pairs])))
        for name in judged:
            across, *others = strongest(done, paths, name)
            if others:
                title = f"{name} over the two values that it depends on most"
                drawn.append((title, map_figure(done[across], done[others[0]], done[name])))
    return [(title, svg_address(figure, title)) for title, figure in drawn]
