"""Tables 1-3 as data (results/tables.json) and as rows beside the paper's printed values."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

from thermojoint.artefacts.units import MEGA
from thermojoint.models.model_file import Provenance
from thermojoint.models.parameters import DeformationModel, Model
from thermojoint.paper import paper_values

#: Parameters of Eqs. 8 and 18 with a length: in m in the model, in µm in the tables.
_LENGTHS = ("C", "D", "E", "F")

#: Name of a parameter to its unit in the tables.
UNITS = {
    "K": "K",
    "a": "1/m2",
    "alpha": "m2/s",
    "r": "m",
    "r0": "m",
    "distances_m": "m",
    "q": "1",
    "A": "K/s",
    "B": "K/s2",
    "gamma": "1/s",
    "C": "um",
    "D": "um",
    "E": "um/s",
    "F": "um/s",
    "c": "1/s",
    "d": "1/s",
    "e": "1/s",
    "f": "1/s",
    "max_abs_error_K": "K",
    "max_abs_error_um": "um",
}

NOTE = (
    "The two columns describe two different structures and need not agree. The paper prints "
    "neither the units of its parameters nor the positions of its sensors and sources, and only "
    "part of its geometry; K and the displacement parameters scale with the heat input and the "
    "place of measurement, a and alpha stand for wall, film and distance together, and f_R "
    "follows our own rule. Beyond that several parameters of Eqs. 8 and 18 trade against each "
    "other: different values can draw the same curve. What should agree is how well each form "
    "fits its own structure: the largest errors below the tables. A value marked * ended at the "
    "bound of what its fit allows."
)


@dataclass(frozen=True)
class Row:
    """One parameter: name, unit, our value, the paper's, and whether the fit ended at a bound."""

    name: str
    unit: str
    ours: float | None
    paper: float | None
    at_bound: bool = False


@dataclass(frozen=True)
class Block:
    """A titled list of rows, part of one table."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class PrintedTable:
    """A table of the paper compared with ours."""

    title: str
    blocks: tuple[Block, ...]


def tables_json(model: Model, provenance: Provenance) -> dict[str, Any]:
    """Return Tables 1-3 as plain data.

    Parameters
    ----------
    model : Model
        The calibrated model.
    provenance : Provenance
        Its largest calibration errors, under "thermal" and "sources" (K), "deformation.AXIS" and
        "sources.INPUT.AXIS" (µm); missing ones become None.

    Returns
    -------
    dict
        ``table1``, ``table2``, ``table3`` and ``units``. Displacement parameters in µm and µm/s per
        unit of heat input or strength.
    """
    linear, kelvin, micro = model.linear, provenance.max_abs_error_K, provenance.max_abs_error_um
    inputs = [str(level) for source in model.sources[:1] for level in source.strengths]
    thermal = asdict(linear.thermal) | asdict(linear.regularisation)
    return {
        "table1": {
            "thermal": thermal | {"max_abs_error_K": kelvin.get("thermal")},
            "deformation": {
                axis: _micrometres(shape, "CDEFcdef" if shape.F else "CDEcde")
                | {"max_abs_error_um": micro.get(f"deformation.{axis}")}
                for axis, shape in linear.deformation.items()
            },
        },
        "table2": {
            "sources": [
                {
                    "a": source.a,
                    "alpha": source.alpha,
                    "K": source.K,
                    "r0": source.r0,
                    "q": {str(level): q for level, q in source.strengths.items()},
                }
                | asdict(source.regularisation)
                for source in model.sources
            ],
            "distances_m": [list(row) for row in model.distances],
            "max_abs_error_K": kelvin.get("sources"),
        },
        "table3": {
            axis: {
                "sources": [
                    _micrometres(source.deformation[axis], "CDEFcdef") for source in model.sources
                ]
            }
            for axis in linear.deformation
        }
        | {
            "max_abs_error_um": {
                level: {axis: micro.get(f"sources.{level}.{axis}") for axis in linear.deformation}
                for level in inputs
            }
        },
        "units": dict(UNITS),
    }


def printed_tables(
    tables: Mapping[str, Any], at_bound: Mapping[str, Collection[str]] = MappingProxyType({})
) -> tuple[PrintedTable, ...]:
    """Return Tables 1-3 of `tables_json` with the paper's values, where available."""
    return (
        _table1(tables["table1"], at_bound),
        _table2(tables["table2"], at_bound.get("sources", ())),
        _table3(tables["table3"], at_bound),
    )


def _table1(table: Mapping[str, Any], bounds: Mapping[str, Collection[str]]) -> PrintedTable:
    thermal, paper_thermal = table["thermal"], paper_values.TABLE1_THERMAL
    reached = bounds.get("thermal", ())
    blocks = [_block("Thermal model (Eqs. 2, 7)", thermal, paper_thermal, reached)]
    for axis, shape in table["deformation"].items():
        paper = paper_values.TABLE1_DEFORMATION.get(axis, {})
        claim = {"max_abs_error_um": paper_values.CALIBRATION_ERROR_UM} if paper else {}
        reached = bounds.get(f"deformation.{axis}", ())
        blocks.append(_block(f"Deformation {axis} (Eq. 8)", shape, paper | claim, reached))
    return PrintedTable("Table 1: linear thermal and deformation models", tuple(blocks))


def _table2(table: Mapping[str, Any], bounds: Collection[str]) -> PrintedTable:
    blocks = []
    for index, source in enumerate(table["sources"]):
        strengths = {f"q {level}": value for level, value in source["q"].items()}
        ours = {name: value for name, value in source.items() if name != "q"} | strengths
        title, paper = f"Fictitious source {index + 1}", _nth(paper_values.TABLE2, index)
        blocks.append(_block(title, ours, paper, _of_source(bounds, index)))
    distances = {
        f"r {i + 1}{j + 1}": value
        for i, row in enumerate(table["distances_m"])
        for j, value in enumerate(row)
    }
    blocks.append(_block("Distances source to sensor", distances, {}))
    # The paper's distances have no unit, so they cannot be compared with metres.
    printed = tuple(
        Row(f"r {i + 1}{j + 1}", "", None, value)
        for i, row in enumerate(paper_values.TABLE2_DISTANCES)
        for j, value in enumerate(row)
    )
    blocks.append(Block("Distances as the paper prints them, without a unit", printed))
    blocks.append(_block("Both sources", {"max_abs_error_K": table["max_abs_error_K"]}, {}))
    return PrintedTable("Table 2: fictitious contact heat sources (Eqs. 2, 7, 16)", tuple(blocks))


def _table3(table: Mapping[str, Any], bounds: Mapping[str, Collection[str]]) -> PrintedTable:
    blocks = [
        _block(
            f"Source {index + 1}, {axis}",
            shape,
            _nth(paper_values.TABLE3.get(axis, ()), index),
            _of_source(bounds.get(f"sources.{axis}", ()), index),
        )
        for axis, part in table.items()
        if axis != "max_abs_error_um"
        for index, shape in enumerate(part["sources"])
    ]
    for level, errors in table["max_abs_error_um"].items():
        rows = tuple(
            Row(f"max_abs_error_um {axis}", "um", value, None) for axis, value in errors.items()
        )
        blocks.append(Block(f"Both sources, heat input {level}", rows))
    return PrintedTable("Table 3: deformation by the fictitious sources (Eq. 18)", tuple(blocks))


def _block(
    title: str,
    ours: Mapping[str, float | None],
    paper: Mapping[str, float],
    at_bound: Collection[str] = (),
) -> Block:
    return Block(
        title,
        tuple(
            Row(name, _unit(name), value, paper.get(name), name in at_bound)
            for name, value in ours.items()
        ),
    )


def _of_source(at_bound: Collection[str], index: int) -> list[str]:
    """Names of one source's parameters, without the number appended in fits of several sources."""
    number = str(index + 1)
    return [name.removesuffix(number) for name in at_bound if name.endswith(number)]


def _unit(name: str) -> str:
    if name.startswith("q "):
        return UNITS["q"]
    return UNITS["r"] if name.startswith("r ") else UNITS[name]


def _nth(items: tuple[dict[str, float], ...], index: int) -> dict[str, float]:
    return items[index] if index < len(items) else {}


def _micrometres(shape: DeformationModel, names: str) -> dict[str, float]:
    values = asdict(shape)
    return {name: values[name] * (MEGA if name in _LENGTHS else 1.0) for name in names}
