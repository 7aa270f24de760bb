"""Short representations of objects: one line, and a table in a notebook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from thermojoint.artefacts.arrays import Array

_WIDTH, _HEIGHT = 320, 96


class Described:
    """Base class of objects that are represented by a few facts."""

    def _facts(self) -> dict[str, str]:
        """Return the facts, in their order."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Return one line."""
        facts = (f"{name}: {fact}" for name, fact in self._facts().items())
        return f"{type(self).__name__}({'; '.join(facts)})"

    def _repr_html_(self) -> str:
        return as_html(type(self).__name__, self._facts())


def counted(count: int, singular: str, plural: str = "") -> str:
    """Return a number with its noun: ``1 joint``, ``2 bodies``."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def as_html(title: str, facts: Mapping[str, str], picture: str = "") -> str:
    """Return a title, a table of facts and perhaps a picture (SVG) as HTML."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(fact)}</td></tr>"
        for name, fact in facts.items()
    )
    return f"<div><b>{escape(title)}</b><table>{rows}</table>{picture}</div>"


def curves(times: Array, values: Array, names: Sequence[str]) -> str:
    """Return a small picture of some curves as SVG.

    Parameters
    ----------
    times : ndarray, shape (n,)
    values : ndarray, shape (n, k)
    names : sequence of str
        Of the curves, shown with their last values.
    """
    some = np.unique(np.linspace(0, len(times) - 1, min(len(times), _WIDTH)).astype(int))
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    across = (times[some] - times[0]) / max(float(times[-1] - times[0]), 1e-300) * _WIDTH
    lines = []
    for k, name in enumerate(names):
        down = (high - values[some, k]) / max(high - low, 1e-300) * _HEIGHT
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))
        shade = 30 + 200 * k // max(len(names), 1)
        lines.append(
            f"<polyline points='{points}' fill='none' stroke='hsl({shade},70%,45%)'>"
            f"<title>{escape(name)}</title></polyline>"
        )
    return (
        f"<svg viewBox='0 -2 {_WIDTH} {_HEIGHT + 4}' width='{_WIDTH}' height='{_HEIGHT}' "
        f"role='img' aria-label='{escape(', '.join(names))}'>{''.join(lines)}</svg>"
    )
