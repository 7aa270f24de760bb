"""The command `verify`: run the suite and print its tables."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from thermojoint.console import Report
from thermojoint.verification.report import shown
from thermojoint.verification.suite import GROUPS, Result, run


def run_all(report: Report) -> list[Result]:
    """Run every group, reporting the number of finished ones."""
    results: list[Result] = []
    report("verifying", 0, len(GROUPS))
    for result in run(GROUPS):
        results.append(result)
        report("verifying", len(results), len(GROUPS))
    return results


def show(console: Console, results: Sequence[Result]) -> None:
    """Print one table for each group, and the number of passed checks."""
    for result in results:
        table = Table()
        table.add_column("quantity", overflow="fold")
        for name in ("reference", "computed", "error", "tolerance"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("source", overflow="fold")
        for check in result.checks:
            table.add_row(*shown(check), style=None if check.passed else "bold red")
        console.print()
        console.print(result.group.title, style="bold")
        console.print(table)
    checks = [check for result in results for check in result.checks]
    failed = [check.name for check in checks if not check.passed]
    console.print(f"\n{len(checks) - len(failed)} of {len(checks)} checks are within tolerance.")
    for name in failed:
        console.print(f"out of tolerance: {name}", style="bold red")
