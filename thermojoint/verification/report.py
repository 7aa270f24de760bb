"""Results of the suite as JSON data and as the page of the documentation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from textwrap import fill

from thermojoint.verification.check import Check
from thermojoint.verification.suite import Result

_FIELDS = (
    "name",
    "quantity",
    "unit",
    "reference",
    "computed",
    "relative_error",
    "tolerance",
    "source",
)

_HEAD = """# Verification

This page is written by the suite itself:

```sh
thermojoint verify --json verify.json --markdown docs/verification.md
```

The command prints the same table, writes it as JSON and ends with exit code 1 if anything is out of
tolerance. The cases are the modules of `verification/`. They use the simulator's own operators,
joint laws and solver of the gap equations, and its march or heat step where time passes.
Temperatures are those of all nodes; the reduced thermal model, a case's default
([reduction.md](reduction.md)), has rows of its own. The error is relative to the reference unless
said otherwise.
"""


def results_data(results: Sequence[Result]) -> dict[str, list[dict[str, str | float | None]]]:
    """Return the content of ``verify --json``: {"cases": [...]}, one entry for each check.

    A number that is not finite (its check fails) becomes None: JSON allows only finite ones.
    """
    checks = [check for result in results for check in result.checks]
    return {"cases": [{name: _plain(getattr(check, name)) for name in _FIELDS} for check in checks]}


def _plain(value: str | float) -> str | float | None:
    if isinstance(value, str):
        return value
    return float(value) if math.isfinite(value) else None


def markdown(results: Sequence[Result]) -> str:
    """Return the docs page."""
    checks = [check for result in results for check in result.checks]
    good = sum(check.passed for check in checks)
    parts = [_HEAD, f"{good} of {len(checks)} checks are within tolerance.\n"]
    descriptions = _descriptions()
    for result in results:
        text = descriptions.get(result.group.title, "")
        text = fill(text, width=104, break_long_words=False, break_on_hyphens=False)
        about = f"{text}\n\n" if text else ""
        parts.append(f"## {result.group.title}\n\n{about}{_table(result.checks)}")
    return "\n".join(parts)


def _descriptions() -> dict[str, str]:
    """Return the description of each group by its title: the sections of templates/about.md."""
    text = (files("thermojoint.verification") / "templates" / "about.md").read_text("utf-8")
    sections = (section.partition("\n") for section in text.removeprefix("## ").split("\n## "))
    return {title: " ".join(body.split()) for title, _, body in sections}


def _table(checks: Sequence[Check]) -> str:
    lines = [
        "| quantity | reference | computed | error | tolerance | source |",
        "|---|---|---|---|---|---|",
    ]
    for check in checks:
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in shown(check)) + " |")
    return "\n".join(lines) + "\n"


def shown(check: Check) -> tuple[str, str, str, str, str, str]:
    """Return name and unit, reference, computed value, error, tolerance and source as text."""
    unit = "" if check.unit == "1" else f", {check.unit}"
    mark = "" if check.passed else " **out**"
    return (
        f"{check.name}{unit}",
        f"{check.reference:.7g}",
        f"{check.computed:.7g}",
        f"{check.relative_error:.1e}{mark}",
        f"{check.tolerance:.1e}",
        check.source,
    )
