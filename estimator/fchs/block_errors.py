"""Contributions of the blocks of Figure 5 to the error, using true signals.

The difference between two rows is the error of the replaced block.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from estimator.rows import Row
from estimator.superposition import held_heat, superposed
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import axes_of, columns_of, probes_of
from thermojoint.artefacts.units import MEGA
from thermojoint.models import blocks
from thermojoint.models.assembly import Assembly, assemble
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import readings

if TYPE_CHECKING:
    import xarray as xr


def assembled_for(model: Model, times: Array) -> Assembly:
    """Return the estimator for samples at `times` (s), by their shortest interval.

    The run length is at least that of the longest calibration run, for which the inverse of the
    sources is known to be stable.
    """
    length = max(float(times[-1] - times[0]), model.span.duration_s)
    order = (*model.linear.deformation, *model.linear.direct)
    return _assembled(_Asked(model.digest, order, float(np.diff(times).min()), length, model))


@dataclass(frozen=True)
class _Asked:
    """An estimator to be assembled: interval and length in s.

    The model is compared by its digest, which is the same whatever the order of axes and sensors,
    and by this order.
    """

    digest: str
    order: tuple[str, ...]
    interval: float
    length: float
    model: Model = field(compare=False)


# Responses of one length are judged one after the other, each by a few models.
@lru_cache(maxsize=4)
def _assembled(asked: _Asked) -> Assembly:
    return assemble(asked.model, asked.interval, asked.length)


def block_errors(
    case: str,
    response: xr.Dataset,
    model: Model,
    reference: xr.Dataset,
    *,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, np.ndarray] | None = None,
) -> list[Row]:
    """Return the largest errors with true signals in place of estimated ones; see `validate`.

    Rows, by ``driven_by``: "temperatures" (the estimator as it is), "true heat" (Q for Q̂ in blocks
    2 and 3), "true deviations" (∂T from the superposed reference for blocks 4 to 7), "both".
    Errors are relative to the superposed reference (linear), the displacement minus that
    (nonlinear) and the displacement (total). With "both", the remaining linear error is that of Eq.
    8, and the remaining nonlinear error that of the source model and Eq. 18.
    """
    seen = readings(response, tuple(model.linear.direct), roles, noise)
    assembly = assembled_for(model, seen.times)
    times, heat = seen.times, held_heat(response)
    actual = columns_of(response, "displacement", assembly.axes)
    order = [axes_of(response).index(axis) for axis in assembly.axes]
    linear = superposed(reference, response, "displacement")[:, order]
    known = probes_of(response)
    probes = [known.index((roles or {}).get(role, role)) for role in model.linear.direct]
    same = [probes_of(reference).index(known[probe]) for probe in probes]
    on_linear = superposed(reference.isel(probe=same), response.isel(probe=probes), "temperature")

    estimated_heat = blocks.heat_part(assembly, times, seen.delta_T)
    true_deviation = seen.temperatures - on_linear
    rows: list[Row] = []
    for driven_by, q, given in (
        ("temperatures", estimated_heat, None),
        ("true heat", heat, None),
        ("true deviations", estimated_heat, true_deviation),
        ("both", heat, true_deviation),
    ):
        deviation = given
        if deviation is None:
            deviation = blocks.deviations(assembly, times, q, seen.temperatures)
        part_linear = blocks.linear_part(assembly, times, q)
        part_nonlinear = blocks.nonlinear_part(assembly, times, deviation)
        for k, axis in enumerate(assembly.axes):
            errors = {
                "linear_error_um": part_linear - linear,
                "nonlinear_error_um": part_nonlinear - (actual - linear),
                "total_error_um": part_linear + part_nonlinear - actual,
            }
            worst = {name: float(np.abs(e[:, k]).max() * MEGA) for name, e in errors.items()}
            rows.append({"case": case, "driven_by": driven_by, "axis": axis, **worst})
    return rows
