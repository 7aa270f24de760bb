"""Report of a reproduction, one self-contained HTML page: tables, validation, solver, pictures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from estimator.rows import Row
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.templates import templates_of
from thermojoint.console import number, rounded
from thermojoint.paper import paper_values
from thermojoint.paper.summary import STILL, Convergence, PressureShare, SchemeErrors
from thermojoint.paper.tables import NOTE, PrintedTable
from thermojoint.paper.verdict import error_table, paper_claim, verdict

_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class Picture:
    """A picture file and its caption."""

    path: Path
    caption: str

    @property
    def source(self) -> str:
        """The picture as a data URL."""
        suffix = self.path.suffix.lower()
        if suffix not in _TYPES:
            raise InputError(f"{self.path}: a report holds .png and .svg pictures only")
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:{_TYPES[suffix]};base64,{data}"


@dataclass(frozen=True)
class ReportData:
    """Content of the page."""

    #: The case's title.
    title: str
    #: Versions, mesh sizes, solver.
    facts: Sequence[tuple[str, str]]
    #: Tables 1-3.
    tables: Sequence[PrintedTable] = ()
    #: Rows of `estimator.fchs.judging.validate`.
    validation: Sequence[Row] = ()
    #: The two calibrations of Eq. 18 compared with the linear estimator.
    schemes: Sequence[SchemeErrors] = ()
    #: Rows of `estimator.fchs.block_errors`.
    blocks: Sequence[Row] = ()
    #: Response to its solver statistics.
    convergence: Mapping[str, Convergence] = field(default_factory=dict)
    #: Share of the pressure change at the heat input of Figure 7.
    share: PressureShare | None = None
    #: Unavailable estimator to the reason.
    left_out: Mapping[str, str] = field(default_factory=dict)
    #: The chosen sensors and the method.
    placement: str = ""
    #: Model to the report of its fit.
    fits: Mapping[str, str] = field(default_factory=dict)
    #: Pictures in the order of appearance.
    pictures: Sequence[Picture] = ()
    #: The whole case as text.
    case: str = ""


def report_html(data: ReportData) -> str:
    """Return the page; all content is escaped, and no other files are loaded."""
    environment = templates_of("thermojoint.paper")
    environment.filters["number"] = number
    environment.filters["rounded"] = rounded
    environment.globals["paper_claim"] = paper_claim
    template = environment.get_template("report.html.j2")
    return template.render(
        title=data.title,
        generator="reproduce",
        data=data,
        verdict=verdict(data.validation),
        errors=error_table(data.validation),
        still=STILL,
        note=NOTE,
        citation=paper_values.CITATION,
        paper_share=paper_values.PRESSURE_SHARE,
    )
