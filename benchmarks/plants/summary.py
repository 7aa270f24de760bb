"""Medians and 90th percentiles over plants, and how far they are from what is asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd
from rich.table import Table

#: Compared groups.
GROUPS = ["sensors", "calibration", "case", "estimator"]


def summary_of(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for each number of sensors, calibration, case and estimator.

    The error of a plant is its largest along either axis; the band's cover is that of all samples,
    and its width the mean over a run along the wider axis, then the median over plants; likewise
    the interval score.

    `rows`: as `judging.figures` makes them, with plant and calibration.
    """
    table = pd.DataFrame(rows)
    each = (
        table.groupby([*GROUPS, "plant"], sort=False)
        .agg(
            error=("max_abs_error_um", "max"),
            rms=("rms_error_um", "max"),
            cover=("band_cover", "mean"),
            width=("mean_band_width_um", "max"),
            score=("interval_score_um", "max"),
        )
        .reset_index()
    )
    same = ["sensors", "calibration", "case", "plant"]
    linear = each[each.estimator == "linear"].set_index(same).error
    found = []
    for names, part in each.groupby(GROUPS, sort=False):
        beside = part.set_index(same).error
        both = pd.concat([beside, linear], axis=1, join="inner", keys=["own", "linear"])
        banded = part.cover.notna().any()
        found.append(
            dict(zip(GROUPS, names, strict=True))
            | {
                "plants": len(part),
                "median_um": float(part.error.median()),
                "p90_um": float(part.error.quantile(0.9)),
                "largest_um": float(part.error.max()),
                "median_rms_um": float(part.rms.median()),
                "worse_than_linear": int((both.own > both.linear).sum()) if len(both) else None,
                "band_cover": float(part.cover.mean()) if banded else None,
                "band_cover_p10": float(part.cover.quantile(0.1)) if banded else None,
                "band_width_um": float(part.width.median()) if banded else None,
                "interval_score_um": float(part.score.median()) if banded else None,
            }
        )
    return found


def table_of(summary: Sequence[dict[str, Any]]) -> Table:
    """Return the summary as a table for a terminal."""
    table = Table(title="largest error along either axis over plants, µm")
    for name in (*GROUPS, "plants", "median", "90 %", "largest"):
        table.add_column(name)
    for name in ("worse than linear", "in band", "worst tenth", "band, µm", "interval score"):
        table.add_column(name)
    for row in summary:
        sizes = (f"{row[name]:.2f}" for name in ("median_um", "p90_um", "largest_um"))
        worse = row["worse_than_linear"]
        covers = row["band_cover"], row["band_cover_p10"]
        widths = row["band_width_um"], row["interval_score_um"]
        table.add_row(
            *(str(row[name]) for name in (*GROUPS, "plants")),
            *sizes,
            "–" if worse is None else str(worse),
            *("–" if cover is None else f"{100.0 * cover:.1f} %" for cover in covers),
            *("–" if width is None else f"{width:.2f}" for width in widths),
        )
    return table
