"""Temperatures of the sensors of a joint-aware model, row by row, from a table in any dialect.

A table has one of two layouts, distinguished by its units; the order is free, other columns are
ignored, missing readings are NaN:

- time, ``NAME_K``, ..., ``ambient_K``: above the ambient at which the machine was cold; without the
  last column the ambient is constant;
- time, ``NAME_degC``, ..., ``ambient_degC``, or °F: as thermometers read. The machine was cold at
  the first plausible ambient temperature in the log, or in the first log of a run that is
  continued.

Loads that change have columns ``NAME_percent``, of the load in the case; the positions of
moving axes are ``NAME_pos_mm``, their odometers ``NAME_way_mm``, powers that determine the heat of
a source ``NAME_power_W``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from estimator.kind import Cold
from estimator.measured import temperatures_in
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log


def log_samples(
    pieces: Iterable[Log],
    sensors: Sequence[str],
    where: str,
    others: Mapping[str, str] | None = None,
    cold: Cold | None = None,
    zero_of: Callable[[Array, float], float] = lambda temperatures, ambient: ambient,
) -> Iterator[tuple[float, ...]]:
    """Yield (time s, temperature of every sensor K, ambient K, others); NaN for a missing reading.

    Parameters
    ----------
    pieces : iterable of Log
        A log, in the order of time (`thermojoint.artefacts.tables.pieces`).
    sensors : sequence of str
        Names of the sensors.
    where : str
        Name of the file, for error messages.
    others : mapping of str to str, optional
        Units by the names of the loads that change, of positions, ways and powers.
    cold : Cold, optional
        Ambient at which the machine was cold; set here where it is not known.
    zero_of : callable, optional
        (temperatures of the sensors, ambient) to the ambient of the cold machine, or NaN if that is
        implausible.

    Raises
    ------
    InputError
        A sensor, a load, a position, a way or a power has no column, a temperature has two, time
        restarts, only the ambient is absolute, or absolute temperatures continue those above an
        ambient, or a run whose cold ambient is not recorded.
    """
    known = Cold() if cold is None else cold
    units = others or {}
    last = -math.inf
    for piece in pieces:
        if not piece.times[0] > last:
            raise InputError(f"{where}: time restarts; estimate each run by itself")
        last = float(piece.times[-1])
        at, above = _columns(piece, sensors, where)
        values = piece.values[:, [k for k in at if k >= 0]]
        if at[-1] < 0:
            values = np.column_stack((values, np.zeros(len(values))))
        given, there = np.empty((len(values), len(units))), {one.base for one in piece.columns}
        for k, (name, unit) in enumerate(units.items()):
            if name not in there:
                raise InputError(
                    f"{where}: no column {name}_{unit}, which the model needs; record it, or name "
                    f"yours: --column THEIRS={name}_{unit}"
                )
            given[:, k] = piece.at(name)
        for time, row, rest in zip(piece.times.tolist(), values, given, strict=True):
            if math.isnan(known.value):
                if known.continued and not above:
                    raise InputError(
                        f"{where}: the state that it continues does not say at which ambient the "
                        f"machine was cold; give {sensors[0]}_K, ..., ambient_K above that one"
                    )
                known.value = 0.0 if above else zero_of(row[:-1], float(row[-1]))
            elif known.value == 0.0 and not above:
                raise InputError(
                    f"{where}: continues temperatures above the ambient of a cold machine; give "
                    f"{sensors[0]}_K, ..., ambient_K again"
                )
            yield (time, *(row - (0.0 if above else known.value)).tolist(), *rest.tolist())


def _columns(log: Log, sensors: Sequence[str], where: str) -> tuple[list[int], bool]:
    """Columns of the sensors and the ambient (-1 if it is not recorded), absolute or `above` it."""
    wanted = [*sensors, "ambient"]
    rises, read = (temperatures_in(log, wanted, above, where) for above in (True, False))
    if set(sensors) <= set(rises):
        if "ambient" in read and "ambient" not in rises:
            raise InputError(
                f"{where}: {log.columns[read['ambient']].name} is no rise, as those of the sensors "
                "are; give ambient_K, above the ambient at which the machine was cold"
            )
        return [rises.get(name, -1) for name in wanted], True
    if set(wanted) <= set(read):
        return [read[name] for name in wanted], False
    if set(sensors) <= set(read):
        raise InputError(
            f"{where}: no column ambient_degC, of the air, which the model needs beside its "
            "sensors; record it, or name yours: --column THEIRS=ambient_degC"
        )
    above_ambient = ", ".join(f"{name}_K" for name in sensors)
    absolute = ", ".join(f"{name}_degC" for name in wanted)
    raise InputError(
        f"{where}: columns {', '.join(log.names) or 'none'}; the model needs time_s, "
        f"{above_ambient} or time_s, {absolute}"
    )
