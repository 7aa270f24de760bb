"""Results of the harness: ``bench.json``, and the table in the docs."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.performance.timing import Row, Skipped
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text

BEGIN, END = "<!-- bench: begin -->", "<!-- bench: end -->"
PACKAGES = ("thermojoint", "numpy", "scipy", "scikit-fem", "numba", "pypardiso", "mkl")


@dataclass(frozen=True)
class Target:
    """Requirement for a row: its `which` is at least or at most `bound`."""

    which: str
    bound: float
    at_least: bool = False

    def met(self, row: Row) -> bool:
        """Say whether the row does."""
        value = float(getattr(row, self.which))
        return value >= self.bound if self.at_least else value <= self.bound

    def text(self, unit: str) -> str:
        """Return it as the table shows it."""
        sign, shown = "≥" if self.at_least else "≤", "" if self.which == "ratio" else f" {unit}"
        return f"{self.which} {sign} {self.bound:g}{shown}"


_NO_WORSE = (Target("ratio", 1.0, at_least=True),)
TARGETS: dict[str, tuple[Target, ...]] = {
    "march-vs-refactor": (Target("ratio", 300.0, at_least=True),),
    "march-vs-calculix": (Target("ratio", 500.0, at_least=True),),
    "eq2-vs-quadrature": (Target("ratio", 1000.0, at_least=True),),
    "estimator-per-sample": (Target("ours", 20.0),),
    "joint-aware-sample": (Target("ours", 250.0),),
    "joint-aware-percentile": (Target("ours", 1000.0),),
    "joint-aware-calibration": (Target("ours", 8.0),),
    # Flat but for the noise of the clock.
    "estimator-growth": (Target("ratio", 0.9, at_least=True),),
    "calibration": (Target("ours", 10.0),),
    "reproduce-cold": (Target("ours", 60.0),),
    "reproduce-kept": (Target("ours", 35.0),),
    # 0.3 s and 1 s where NumPy takes 0.1 s.
    "start-version": (Target("ratio", 0.33, at_least=True),),
    "start-help": (Target("ratio", 0.33, at_least=True),),
    "start-simulate": (Target("ratio", 0.1, at_least=True),),
    "march-1050": (Target("ratio", 4.3, at_least=True),),
    "adaptive-35min": (Target("ours", 150.0),),
    "adaptive-day": (Target("ours", 2000.0),),
    "adaptive-among-many": (Target("ours", 8.0),),
    "start-marched": (Target("ours", 1.0),),
    "start-memory": (Target("ours", 200.0),),
    "map-1000": (Target("ours", 0.1),),
    "moving-step": (Target("ratio", 0.5, at_least=True),),
    "moving-step-knee": (Target("ratio", 0.5, at_least=True),),
    "moving-set-up": (Target("ratio", 1.0 / 3.0, at_least=True),),
    "march-ensemble": (Target("ratio", 13.5, at_least=True),),
    "march-ensemble-full": (Target("ratio", 5.4, at_least=True),),
    "step-192-contacts": (Target("ours", 1.0),),
    "step-432-contacts": (Target("ours", 4.0),),
    "batch-10000": (Target("ours", 8000.0, at_least=True),),
    "setup-changed-source": (Target("ours", 0.6),),
    "setup-changed-film": (Target("ours", 0.6),),
    "setup-changed-589k": (Target("ours", 5.0),),
    "contacts-2000": (Target("ours", 600.0),),
    "contacts-2000-memory": (Target("ours", 20.0),),
    "contacts-2000-step": (Target("ours", 80.0),),
    "setup-589k": (Target("ours", 55.0),),
    "setup-589k-memory": (Target("ours", 6.0),),
    "setup-largest": (Target("ours", 1800.0),),
    "memory-reference": _NO_WORSE,
    "memory-500k": _NO_WORSE,
}


def missed(row: Row) -> bool:
    """Say whether a row misses a target."""
    return not all(target.met(row) for target in TARGETS.get(row.name, ()))


def cells(row: Row) -> list[str]:
    """Return name, ours, other, unit, ratio and target as text."""
    target = ", ".join(one.text(row.unit) for one in TARGETS.get(row.name, ()))
    return [
        row.name,
        f"{row.ours:.3g}",
        f"{row.other:.3g}" if row.other < 1e3 else f"{row.other:.0f}",
        row.unit,
        f"{row.ratio:.3g}" if row.ratio < 1e3 else f"{row.ratio:.0f}",
        target + (" **missed**" if missed(row) else ""),
    ]


def write_json(path: Path, results: Sequence[Row | Skipped]) -> None:
    """Write ``bench.json``."""
    content = {
        "machine": machine(),
        "rows": [asdict(one) for one in results if isinstance(one, Row)],
        "skipped": [asdict(one) for one in results if isinstance(one, Skipped)],
    }
    write_text(path, json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def markdown(results: Sequence[Row | Skipped]) -> str:
    """Return the table of the docs, and what each of its rows was measured on."""
    rows = [one for one in results if isinstance(one, Row)]
    here = machine()
    lines = [
        f"{here['cpu']}, {here['cores']} cores, {here['memory_GB']} GB, {here['system']}, "
        f"Python {here['python']}; threads of the linear algebra: {here['threads']}.",
        "",
        "| row | ours | other | unit | ratio | target |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        name, *rest = cells(row)
        lines.append(
            f"| `{name}` | " + " | ".join(cell.replace("|", "\\|") for cell in rest) + " |"
        )
    lines.append("")
    lines += [f"- `{row.name}`: {row.note}." for row in rows]
    lines += [
        f"- `{one.name}`: skipped. {one.reason}" for one in results if isinstance(one, Skipped)
    ]
    return "\n".join(lines) + "\n"


def write_markdown(page: Path, results: Sequence[Row | Skipped]) -> None:
    """Put the table between the two marks of a page; see `marked`."""
    before, after = marked(page)
    write_text(page, f"{before}{BEGIN}\n{markdown(results)}{END}{after}")


def marked(page: Path) -> tuple[str, str]:
    """Return the text before and after the table of a page.

    Raises `InputError`: the page cannot be read or has no marks.
    """
    try:
        text = page.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--markdown {page}: cannot be read; give a page of the docs") from error
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"--markdown {page}: put the lines {BEGIN} and {END} where the table goes")
    return before, after


def machine() -> dict[str, object]:
    """Return on what was measured."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "memory_GB": round(1e-9 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), 1),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "versions": _versions(),
    }


def _cpu() -> str:
    table = Path("/proc/cpuinfo")
    if table.exists():
        for line in table.read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
