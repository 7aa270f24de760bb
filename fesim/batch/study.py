"""Schema of a study: one TOML file that defines the cases of a batch, validated before any work.

Grids, lists and a Latin hypercube vary values of one case; the batch is their product.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fesim.axes.setup import course_of
from fesim.batch.paths import known_paths, with_values
from fesim.batch.summary import columns
from fesim.case.identity import case_id, file_digest, shared_key
from fesim.case.schema import Case, case_from_data, parse_case
from fesim.setup.bolts import first_forces
from fesim.setup.laws import read_conductance_table
from fesim.setup.loads import check_turns, march_inputs
from fesim.setup.parts import make_parts
from fesim.setup.soundness import check_one_ambient, radiated_to
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.settings import toml
from thermojoint.artefacts.settings.read import read_settings
from thermojoint.artefacts.settings.section import File, Finite, Section

Values = dict[str, Any]

#: Stored result of a case: its whole response, or its displacement and the summary's figures.
Keep = Literal["response", "displacement"]

#: More cases than this in one study are treated as a mistake.
MOST_CASES = 100_000

#: Largest integer of the tables.
LARGEST_INTEGER = 2**63 - 1

#: Sections whose histories are read as a check.
LOADS = {"sources", "heat_input", "ambient", "held_temperatures", "loads", "bolts"}


class GridSection(Section):
    """``[[grid]]``: every value, with every value of the others."""

    path: str
    values: Annotated[list[Any], Field(min_length=1)]


class ListSection(Section):
    """``[[list]]``: rows of values that belong together."""

    paths: Annotated[list[str], Field(min_length=1)]
    rows: Annotated[list[list[Any]], Field(min_length=1)]

    @model_validator(mode="after")
    def _rows_fit(self) -> ListSection:
        for number, row in enumerate(self.rows, start=1):
            if len(row) != len(self.paths):
                raise ValueError(f"row {number} has {len(row)} values for {len(self.paths)} paths")
        return self


class RangeSection(Section):
    """``[[latin_hypercube.ranges]]``: one dimension of the hypercube."""

    path: str
    low: Finite
    high: Finite
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _ordered(self) -> RangeSection:
        if self.low >= self.high:
            raise ValueError("low must be below high")
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError('low must be positive with scale = "log"')
        return self


class LatinHypercubeSection(Section):
    """``[latin_hypercube]``: random values, distributed evenly over every range."""

    samples: Annotated[int, Field(ge=1, le=MOST_CASES)]
    seed: Annotated[int, Field(ge=0)]
    ranges: Annotated[list[RangeSection], Field(min_length=1)]


class StudyFile(Section):
    """A whole study file."""

    case: File
    title: str | None = None
    keep: Keep = "response"
    grid: list[GridSection] = []
    list_: list[ListSection] = Field(default=[], alias="list")
    latin_hypercube: LatinHypercubeSection | None = None

    @model_validator(mode="after")
    def _something_varies(self) -> StudyFile:
        paths = varied_paths(self)
        if not paths:
            raise ValueError("nothing varies: add [[grid]], [[list]] or [latin_hypercube]")
        for path in paths:
            if paths.count(path) > 1:
                raise ValueError(f"{path!r} is varied twice; vary it in one place")
            for other in paths:
                if other.startswith(f"{path}."):
                    raise ValueError(f"{path!r} and {other!r} overlap; vary one of them")
        return self


@dataclass(frozen=True)
class StudyCase:
    """One case of a study."""

    #: See `fesim.case.identity.case_id`.
    id: str
    #: See `fesim.case.identity.shared_key`.
    key: str
    #: The varied values by path.
    values: Values
    #: The whole case.
    case: Case


@dataclass(frozen=True)
class Shape:
    """Dimensions of a response other than time."""

    #: Names of the temperature probes.
    probes: tuple[str, ...]
    #: Number of contact elements.
    contacts: int
    #: Names of the moving axes.
    moving_axes: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """Every case of a batch, validated."""

    #: Title of the study, or else of its case.
    title: str
    #: Paths of the varied values.
    paths: tuple[str, ...]
    #: Cases, all different.
    cases: tuple[StudyCase, ...]
    #: Shapes of the responses, by condensation key.
    shapes: dict[str, Shape]
    #: Stored result: ``"response"`` or ``"displacement"``.
    keep: Keep = "response"

    @property
    def columns(self) -> dict[str, str]:
        """Figures of its summary, with their descriptions."""
        return columns(axis for shape in self.shapes.values() for axis in shape.moving_axes)


def read_study(path: Path) -> Study:
    """Read a study and validate all of its cases, without finite elements.

    Raises
    ------
    InputError
        The study or its case is missing or not TOML, a key or a path is unknown, or one of its
        cases is refused.
    """
    path = Path(path)
    given = read_settings(StudyFile, path, "study")
    varied = varied_paths(given)
    if (count := _count(given)) > MOST_CASES:
        raise InputError(f"{path}: {count} cases; {MOST_CASES} are the most, take fewer values")
    study = study_of(given.case, combinations(given), varied, str(path))
    return replace(study, title=given.title or study.title, keep=given.keep)


def study_of(
    source: Path,
    rows: Iterable[Values],
    varied: Sequence[str],
    where: str,
    refused: Callable[[Values, str], None] | None = None,
) -> Study:
    """Return the study of a case with other values, all checked, without finite elements.

    Parameters
    ----------
    source : Path
        The case file.
    rows : iterable of dict
        Values of each case, one for each path.
    varied : sequence of str
        The paths.
    where : str
        Name of the study in error messages.
    refused : callable, optional
        Called with the values of a refused case, which is then left out, and the reason; default:
        raise.

    Raises
    ------
    InputError
        The case is missing or not TOML; a path is unknown, or a case is refused.
    """
    text = toml.read_text(source, "case")
    base = parse_case(text, str(source), source.parent)
    known = known_paths(base)
    for name in varied:
        if name not in known:
            raise unknown_name("value", name, known, f"{where}: {source}")
    digest, table = cache(file_digest), cache(read_conductance_table)
    data = toml.parse(text, str(source))
    cases_by_id: dict[str, StudyCase] = {}
    shapes: dict[str, Shape] = {}
    loads: set[tuple[str, str]] = set()
    for number, values in enumerate(rows, start=1):
        place = f"{where}: case {number} ({shown(values)})"
        try:
            case = case_from_data(with_values(data, values), place, source.parent)
            load = case.model_dump_json(include=LOADS), json.dumps(radiated_to(case))
            study_case = StudyCase(case_id(case, digest), shared_key(case, digest), values, case)
            if load not in loads:
                march_inputs(case)
                first_forces(case)
                check_one_ambient(case)
            check_turns(case)
            for joint in case.joints.values():
                if joint.conductance.file is not None:
                    table(joint.conductance.file)
            if study_case.key not in shapes:
                for name, axis in case.axes.items():
                    course_of(axis, name)
                parts = make_parts(case)
                contacts = sum(len(joint.area) for joint in parts.joints)
                shapes[study_case.key] = Shape(tuple(parts.probes), contacts, tuple(case.axes))
        except InputError as error:
            reason = str(error).removeprefix(f"{place}: ")
            if refused is None:
                raise InputError(f"{place}: {reason}") from error
            refused(values, reason)
            continue
        loads.add(load)
        cases_by_id.setdefault(study_case.id, study_case)
    return Study(base.title, tuple(varied), tuple(cases_by_id.values()), shapes)


def varied_paths(given: StudyFile) -> list[str]:
    """Return the varied paths of a study, in the order of the file."""
    grids = [section.path for section in given.grid]
    lists = [path for section in given.list_ for path in section.paths]
    cube = given.latin_hypercube
    return grids + lists + ([span.path for span in cube.ranges] if cube else [])


def combinations(given: StudyFile) -> Iterator[Values]:
    """Yield the varied values of every case, the last section changing fastest."""
    sections: list[list[Values]] = [
        [{section.path: value} for value in section.values] for section in given.grid
    ]
    sections += [
        [dict(zip(section.paths, row, strict=True)) for row in section.rows]
        for section in given.list_
    ]
    if given.latin_hypercube:
        sections.append(latin_hypercube(given.latin_hypercube))
    for parts in product(*sections):
        yield {path: value for part in parts for path, value in part.items()}


def latin_hypercube(section: LatinHypercubeSection) -> list[Values]:
    """Return the samples of a Latin hypercube, reproducible by the seed.

    Each range is divided into as many strips as there are samples, equal in its scale, with one
    sample in each (McKay, Beckman & Conover 1979).
    """
    from scipy.stats import qmc

    ranges = section.ranges
    unit = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(section.seed))
    return values_in(ranges, unit.random(section.samples))


def values_in(ranges: Sequence[RangeSection], unit: NDArray[np.float64]) -> list[Values]:
    """Return the values for samples (n, ranges) in the unit cube, each in its range's scale."""
    low, high = (
        np.array([np.log(end) if span.scale == "log" else end for span, end in ends])
        for ends in (
            [(span, span.low) for span in ranges],
            [(span, span.high) for span in ranges],
        )
    )
    return [
        {
            span.path: float(np.exp(value) if span.scale == "log" else value)
            for span, value in zip(ranges, row, strict=True)
        }
        for row in low + (high - low) * unit
    ]


def shown(values: Values) -> str:
    """Return varied values in one line."""
    return ", ".join(f"{path} = {plain(value)}" for path, value in values.items())


def brief(values: Values) -> str:
    """Return varied values in short form: the last word of each path, four digits."""
    parts = []
    for path, value in values.items():
        number = f"{value:.4g}" if isinstance(value, float) else plain(value)
        parts.append(f"{path.rpartition('.')[2]} {number}")
    return ", ".join(parts)


def plain(value: Any) -> str | float | int | bool:  # noqa: ANN401 - any TOML value
    """Return a varied value for a table: sections and lists as JSON, huge integers as floats."""
    if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        return float(value)
    if isinstance(value, str | float | int | bool):
        return value
    return json.dumps(value, default=str)


def _count(given: StudyFile) -> int:
    count = given.latin_hypercube.samples if given.latin_hypercube else 1
    for size in [len(section.values) for section in given.grid] + [
        len(section.rows) for section in given.list_
    ]:
        count *= size
    return count
