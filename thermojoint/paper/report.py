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
        """The picture itself as a data address."""
        suffix = self.path.suffix.lower()
        if suffix not in _TYPES:
            raise InputError(f"{self.path}: a report holds .png and .svg pictures only")
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:{_TYPES[suffix]};base64,{data}"


@dataclass(frozen=True)
class ReportData:
    """Content of the page.

    Attributes
    ----------
    title : str
        The case's title.
    facts : sequence of (str, str)
        Versions, mesh sizes, solver.
    tables : sequence of PrintedTable
        Tables 1-3.
    validation, blocks : sequence of mapping
        Rows of `estimator.fchs.judging.validate` and `estimator.fchs.block_errors`.
    schemes : sequence of SchemeErrors
        The two calibrations of Eq. 18 compared with the linear estimator.
    convergence : mapping
        Response to its solver statistics.
    share : PressureShare, optional
        At the heat input of Figure 7.
    left_out : mapping
        Estimator that could not be had to the reason.
    placement : str
        The chosen sensors and the method.
    fits : mapping
        Model to the report of its fit.
    pictures : sequence of Picture
        In order of appearance.
    case : str
        The whole case.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    tables: Sequence[PrintedTable] = ()
    validation: Sequence[Row] = ()
    schemes: Sequence[SchemeErrors] = ()
    blocks: Sequence[Row] = ()
    convergence: Mapping[str, Convergence] = field(default_factory=dict)
    share: PressureShare | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    placement: str = ""
    fits: Mapping[str, str] = field(default_factory=dict)
    pictures: Sequence[Picture] = ()
    case: str = ""


def report_html(data: ReportData) -> str:
    """Return the page; all content is escaped, and nothing is loaded from elsewhere."""
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
