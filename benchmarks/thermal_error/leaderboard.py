"""The leaderboard: every method on every task, as JSON and as a table."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.thermal_error.plants import STRUCTURAL
from benchmarks.thermal_error.scoring import Score
from thermojoint.artefacts.files import write_text

#: How the tasks of measured machines begin.
MEASURED = "measured"
SCHEMA = {"schema": "thermojoint-thermal-error-benchmark", "schema_version": 2}


def as_json(scores: Iterable[Score], not_applicable: Iterable[tuple[str, str, str]]) -> str:
    """Return all scores and what could not be scored (task, method, reason)."""
    content = SCHEMA | {
        "scores": [asdict(one) for one in scores],
        "not_applicable": [
            {"task": task, "method": method, "reason": reason}
            for task, method, reason in not_applicable
        ],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def as_markdown(scores: Sequence[Score]) -> str:
    """Return tables of the machines with other parameters, other structure, and measured ones.

    A row for each method, a column for each task, RMS in µm by channel. The last column is the part
    removed of the uncompensated RMS, mean over tasks and channels, by which the rows are ranked.
    Then a table of the bands: a row for each task, the share inside and the interval score.
    """
    measured = [one for one in scores if one.task.startswith(MEASURED)]
    unlike = [one for one in scores if one.task.split(",")[0] in STRUCTURAL]
    others = [one for one in scores if one not in measured and one not in unlike]
    tables = [_table(part) for part in (others, unlike, measured) if part]
    banded = [one for one in scores if one.cover is not None]
    return "\n".join(tables + ([_bands(banded)] if banded else []))


def _bands(scores: Sequence[Score]) -> str:
    """Return the table of the bands: share of the samples inside, interval score in µm."""
    methods = list(dict.fromkeys(one.method for one in scores))
    heads = [f"{name}, inside, % | {name}, interval score" for name in methods]
    lines = [f"| task | {' | '.join(heads)} |", "|---|" + "---|---|" * len(methods)]
    for task in dict.fromkeys(one.task for one in scores):
        cells = []
        for method in methods:
            found = [one for one in scores if (one.task, one.method) == (task, method)]
            cells.append(" / ".join(f"{100 * (one.cover or 0.0):.0f}" for one in found) or "-")
            cells.append(" / ".join(f"{one.interval_score_um:.3g}" for one in found) or "-")
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _table(scores: Sequence[Score]) -> str:
    tasks = list(dict.fromkeys(one.task for one in scores))
    methods = sorted({one.method for one in scores}, key=lambda name: -_removed(scores, name))
    lines = [
        "| method | " + " | ".join(tasks) + " | removed, mean |",
        "|---|" + "---|" * (len(tasks) + 1),
    ]
    for method in methods:
        cells = []
        for task in tasks:
            found = [one for one in scores if (one.task, one.method) == (task, method)]
            cells.append(" / ".join(f"{one.rms_um:.3g}" for one in found) or "-")
        lines.append(f"| {method} | {' | '.join(cells)} | {100 * _removed(scores, method):.0f} % |")
    return "\n".join(lines) + "\n"


def write(
    scores: Sequence[Score], not_applicable: Sequence[tuple[str, str, str]], out: Path
) -> None:
    """Write ``out``.json and the table beside it as ``out``.md."""
    write_text(out.with_suffix(".json"), as_json(scores, not_applicable))
    write_text(out.with_suffix(".md"), as_markdown(scores))


def _removed(scores: Sequence[Score], method: str) -> float:
    return float(np.mean([one.removed for one in scores if one.method == method]))
