"""All responses of a study in one labelled dataset: a Zarr store for xarray.

It is created before the first case runs, with all cases of the study, and each response fills its
own chunks. Zarr (from 3.1.3 on) writes a chunk as a file atomically, so a reader never sees an
incomplete one, and a killed writer damages nothing. Missing values (a case is pending, failed, is
shorter, or has fewer probes or contact elements) are NaN or empty text.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zarr
from numpy.typing import NDArray

from fesim.axes.setup import turned_within
from fesim.batch.study import Study, plain
from fesim.case.schema import first_step_at, secant_sections
from fesim.forces import COMPONENT_NAMES, ORDER_NAMES
from fesim.setup.loads import source_names
from fesim.setup.outputs import support_names
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.folders import replace_folder
from thermojoint.artefacts.response import VARIABLES

if TYPE_CHECKING:
    from thermojoint.artefacts.response import AnyResponse

#: Status of a case, as a number and in words.
STATUS = {"pending": 0, "done": 1, "failed": 2, "broken": 3}

#: Most time steps in a chunk: an axis for steps of different lengths is mostly empty, and an empty
#: chunk takes no space.
CHUNK = 4096

#: Variables recorded together with others that have an additional dimension.
_WITH = {"force_balance": ("support",), "shear": ("joint",)}

Labels = NDArray[Any]


@dataclass(frozen=True)
class Dataset:
    """An open dataset."""

    #: Variables by name.
    arrays: dict[str, zarr.Array]
    #: Index of each case.
    row: dict[str, int]
    #: Labels of every other dimension.
    labels: dict[str, Labels]


def open_dataset(path: Path, study: Study) -> Dataset:
    """Open the dataset of a study; create it if there is none, or one of another study.

    From another study's dataset the displacements of common cases are kept; without responses they
    exist nowhere else.
    """
    labels = dimension_labels(study)
    layout = _layout_digest(study, labels)
    row = {case.id: number for number, case in enumerate(study.cases)}
    if _layout_in(path) != layout:
        kept = _displacements(path, row) if study.keep == "displacement" else {}
        new = path.with_name(f".{path.name}.new")
        group = _lay_out(new, study, labels)
        dataset = Dataset(dict(group.arrays()), row, labels)
        for case, (times, moved) in kept.items():
            _write(dataset, case, "displacement", {"time": times, "axis": labels["axis"]}, moved)
        group.attrs["layout"] = layout
        zarr.consolidate_metadata(new, zarr_format=2)
        replace_folder(path, new)
    group = zarr.open_group(path, mode="r+", zarr_format=2)
    return Dataset(dict(group.arrays()), row, labels)


def dimension_labels(study: Study) -> dict[str, Labels]:
    """Return the labels of every dimension but ``case``: the union over all cases."""
    shapes = study.shapes.values()
    cases = [case.case for case in study.cases]
    marches = {(case.march.duration_min, case.march.step_s) for case in cases}
    forces = [case for case in cases if case.output.forces]
    asked = {
        "held": _union(case.held_temperatures for case in cases),
        "load": _union(case.loads for case in cases),
        "bolt": _union(case.bolts for case in cases),
        "support": _union(support_names(case) for case in forces),
        "joint": _union(case.joints for case in forces),
        "stress_probe": _union(case.output.stress_probes for case in cases),
    }
    if asked["stress_probe"].size:
        asked |= {"component": np.array(COMPONENT_NAMES), "order": np.array(ORDER_NAMES)}
    return {
        "time": np.unique(np.concatenate([_times(*march) for march in marches])),
        "source": _union(map(source_names, cases)),
        "probe": _union(shape.probes for shape in shapes),
        "axis": np.array(["x", "y", "z"]),
        "space": np.array(["x", "y", "z"]),
        "tangent": np.array(["along", "across"]),
        "contact": np.arange(1, max(shape.contacts for shape in shapes) + 1),
    } | {name: some for name, some in asked.items() if some.size}


def _variables(
    study: Study, labels: dict[str, Labels]
) -> dict[str, tuple[tuple[str, ...], str, str]]:
    """Return the stored variables of a study's responses; unrequested ones have no labels."""
    asked = {"displacement"} if study.keep == "displacement" else set(VARIABLES)
    if not any(secant_sections(case.case) for case in study.cases):
        asked.discard("secant_residual")
    if not any(joint.slip_heating for case in study.cases for joint in case.case.joints.values()):
        asked.discard("friction_heat")
    if all(turned_within(case.case) is None for case in study.cases):
        asked.discard("rotation")
    return {
        name: layout
        for name, layout in VARIABLES.items()
        if name in asked and {*layout[0], *_WITH.get(name, ())} - {"time"} <= labels.keys()
    }


def store_response(dataset: Dataset, case: str, response: AnyResponse) -> None:
    """Write one response into its row; idempotent."""
    for name, (dims, _, _) in VARIABLES.items():
        if name not in response or name not in dataset.arrays:
            continue
        labels = {dim: response[dim].to_numpy() for dim in dims}
        _write(dataset, case, name, labels, response[name].to_numpy())


def _write(
    dataset: Dataset, case: str, name: str, labels: Mapping[str, Labels], values: Labels
) -> None:
    """Write the values of a variable, with the labels of its dimensions, into the row of a case."""
    array = dataset.arrays[name]
    whole = np.full(array.shape[1:], array.fill_value, dtype=array.dtype)
    places = [_positions(dataset.labels[dim], own) for dim, own in labels.items()]
    whole[np.ix_(*places)] = values
    array[dataset.row[case]] = whole


def holds_response(dataset: Dataset, case: str) -> bool:
    """Whether there are values in the row of a case."""
    at, stored = dataset.row[case], dataset.arrays.items()
    own = [array for name, array in stored if name in VARIABLES and array.dtype.kind == "f"]
    return any(not np.isnan(np.asarray(array[at])).all() for array in own)


def store_status(dataset: Dataset, status: Mapping[str, str]) -> None:
    """Write the status of cases, after their responses, so that ``done`` implies their presence."""
    rows = [dataset.row[case] for case in status]
    numbers = np.array([STATUS[word] for word in status.values()], dtype=np.int8)
    if rows:
        dataset.arrays["status"].set_coordinate_selection((np.array(rows),), numbers)


def stored_status(dataset: Dataset) -> dict[str, str]:
    """Return the status of every case in the dataset."""
    names = {number: name for name, number in STATUS.items()}
    column = np.asarray(dataset.arrays["status"][...]).tolist()
    return {case: names[column[at]] for case, at in dataset.row.items()}


def _times(duration: float, step: float) -> NDArray[np.float64]:
    return _rounded(step * np.arange(first_step_at(60.0 * duration, step) + 1.0))


def _rounded(times: Labels) -> NDArray[np.float64]:
    """Times rounded to the nanosecond: 3 x 0.1 s and 1 x 0.3 s are one label."""
    return np.round(times, 9).astype(np.float64)


def _union(names: Any) -> Labels:  # noqa: ANN401 - iterables of iterables of names
    labels = list(dict.fromkeys(name for some in names for name in some))
    return np.array(labels, dtype=str) if labels else np.empty(0, dtype="<U1")


def _positions(labels: Labels, wanted: Labels) -> NDArray[np.int64]:
    if wanted.dtype.kind == "f":
        wanted = _rounded(wanted)
    order = np.argsort(labels, kind="stable")
    positions = order[np.minimum(np.searchsorted(labels, wanted, sorter=order), len(labels) - 1)]
    if not np.array_equal(labels[positions], wanted):
        raise InputError("dataset: a response does not fit the study; give another folder")
    return positions


def _layout_digest(study: Study, labels: dict[str, Labels]) -> str:
    parts: list[Any] = [study.title, list(study.paths), list(_variables(study, labels))]
    parts += [[case.id, *(plain(value) for value in case.values.values())] for case in study.cases]
    parts += [[name, some.tolist()] for name, some in labels.items()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _layout_in(path: Path) -> object:
    """Return the digest of the layout of a dataset; None without one, or an incomplete one."""
    if not (path / ".zgroup").is_file():
        return None
    return zarr.open_group(path, mode="r", zarr_format=2).attrs.get("layout")


def _displacements(path: Path, cases: Iterable[str]) -> dict[str, tuple[Labels, Labels]]:
    """Return times and displacements of some cases in a complete dataset, by case id."""
    if _layout_in(path) is None:
        return {}
    arrays = dict(zarr.open_group(path, mode="r", zarr_format=2).arrays())
    row = {str(case): at for at, case in enumerate(np.asarray(arrays["case"][...]))}
    times, found = np.asarray(arrays["time"][...]), {}
    for case in row.keys() & set(cases):
        values = np.asarray(arrays["displacement"][row[case]])
        read = np.isfinite(values).all(axis=1)
        if read.any():
            found[case] = times[read], values[read]
    return found


def _lay_out(path: Path, study: Study, labels: dict[str, Labels]) -> zarr.Group:
    group = zarr.open_group(path, mode="w", zarr_format=2)
    count = len(study.cases)
    _coordinate(group, "case", ("case",), np.array([case.id for case in study.cases]))
    for name, some in labels.items():
        attrs = {"units": "s", "long_name": "time"} if name == "time" else {}
        _coordinate(group, name, (name,), some, attrs)
    varied = []
    for path_name in study.paths:
        # A whole section, such as "heat_input", may have the name of a variable of the response.
        varied.append(path_name if "." in path_name else f"case.{path_name}")
        values = [plain(case.values[path_name]) for case in study.cases]
        numbers = all(isinstance(value, int | float) for value in values)
        column = np.array(values, dtype=float if numbers else str)
        _coordinate(group, varied[-1], ("case",), column, {"long_name": path_name})
    for name, (dims, unit, long_name) in _variables(study, labels).items():
        shape = (count, *(len(labels[dim]) for dim in dims))
        chunks = (1, *(CHUNK if dim == "time" else max(len(labels[dim]), 1) for dim in dims))
        text = name == "contact_joint"
        units = {"units": unit} if unit else {}
        width = max([1, *(len(joint) for case in study.cases for joint in case.case.joints)])
        group.create_array(
            name,
            shape=shape,
            chunks=tuple(
                min(size, max(whole, 1)) for size, whole in zip(chunks, shape, strict=True)
            ),
            dtype=f"<U{width}" if text else "<f8",
            fill_value="" if text else np.nan,
            attributes=_attributes(("case", *dims), {"long_name": long_name, **units}),
        )
    meanings = {"flag_values": list(STATUS.values()), "flag_meanings": " ".join(STATUS)}
    attributes = _attributes(("case",), meanings)
    group.create_array(
        "status",
        shape=(count,),
        chunks=(min(count, CHUNK),),
        dtype="|i1",
        fill_value=None,
        attributes=attributes,
    )
    group.attrs.update({"title": study.title, "coordinates": " ".join(varied)})
    return group


def _attributes(dims: tuple[str, ...], attrs: dict[str, Any]) -> dict[str, Any]:
    """Attributes of a variable, with its dimensions in xarray's convention."""
    return {"_ARRAY_DIMENSIONS": list(dims), **attrs}


def _coordinate(
    group: zarr.Group,
    name: str,
    dims: tuple[str, ...],
    values: Labels,
    attrs: dict[str, Any] | None = None,
) -> None:
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=tuple(max(size, 1) for size in values.shape),
        dtype=values.dtype.str,
        fill_value=None,
        attributes=_attributes(dims, attrs or {}),
    )
    if values.size:
        array[...] = values
