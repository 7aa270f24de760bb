"""Structures of a learned model: relaxed temperatures, heat from speed and load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibrate.learning.cleaning import Cleaned
from calibrate.learning.positions import Along
from calibrate.learning.rules import Features
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MEGA
from thermojoint.models.learned import Feature, features_of


@dataclass(frozen=True)
class Structure:
    """Features of a fit.

    Attributes
    ----------
    slow : tuple of float
        Relaxations of every temperature, in addition to itself, s.
    exponent : float
        Exponents of the speed; 0 for no heat.
    """

    slow: tuple[float, ...]
    exponent: float


def structures(drives: bool, length: float, rules: Features) -> tuple[Structure, ...]:
    """Return the candidate structures for a run of `length` seconds."""
    slow = [tau for tau in rules.slow if tau <= rules.slowest_share * length]
    relaxations = [(), *((tau,) for tau in slow)]
    exponents = rules.exponents if drives else (0.0,)
    return tuple(Structure(taus, p) for taus in relaxations for p in exponents)


def candidates(cleaned: Cleaned, rules: Features) -> tuple[Feature, ...]:
    """Return all possible features of a structure."""
    quantities = {column.name: column.quantity for column in cleaned.table.columns}
    features = []
    for name in cleaned.sensors:
        values = cleaned.at(name)
        for tau in (0.0, *rules.slow):
            features.append(Feature(name, tau, reference=float(np.mean(values))))
    for name in cleaned.drives:
        largest = float(np.abs(cleaned.at(name)).max())
        exponents = rules.exponents if quantities[name] in ("speed", "feed") else (1.0,)
        features += [
            Feature(name, tau, exponent=p, scale=largest) for p in exponents for tau in rules.heat
        ]
    return tuple(features)


def index_of(
    features: tuple[Feature, ...], sensors: tuple[str, ...], structure: Structure, inputs: int
) -> list[int]:
    """Return the indices of a structure's features on some sensors among the inputs of a fit."""
    taus = (0.0, *structure.slow)
    loads = {
        feature.column
        for feature in features
        if feature.exponent == 1.0
        and not any(o.column == feature.column and o.exponent not in (0.0, 1.0) for o in features)
    }
    index = [
        k
        for k, feature in enumerate(features)
        if (not feature.exponent and feature.column in sensors and feature.tau_s in taus)
        or (
            feature.exponent
            and structure.exponent
            and (feature.exponent == structure.exponent or feature.column in loads)
        )
    ]
    return index if inputs == len(features) else with_slope(index, len(features))


def with_slope(index: Sequence[int], features: int) -> list[int]:
    """Return the inputs of K0, of the constant slope and of the slope for indices of features."""
    return [*index, features, *(features + 1 + k for k in index)]


class Design(NamedTuple):
    """Rows of a log: indices (k,), features (k, n) in units of their prior, displacements, µm."""

    rows: NDArray[np.int64]
    inputs: Array
    outputs: Array


def design(
    cleaned: Cleaned,
    features: tuple[Feature, ...],
    rules: Features,
    along: Along | None = None,
) -> Design:
    """Return the rows (k,) of the table, features (k, n) and displacements (k, axes).

    Rows without a displacement are left out; of several runs, each of which has its own zero, only
    the variations within each are used. Along an axis there is a row for every reading, and the
    inputs are the features, the lever, and the features times the lever.
    """
    table, names, size = cleaned.table, cleaned.table.names, sizes(features, rules)
    wanted = along.displacements if along else cleaned.displacements
    at = [names.index(name) for name in wanted]
    levers = along.levers(table) if along else np.zeros((len(table.times), 0))
    rows, inputs, outputs = [], [], []
    for run in table.runs():
        values = size * features_of(features, names, (table.times[run], table.values[run]))
        measured = MEGA * table.values[run, at]
        known = known_rows(cleaned, run, rules)
        if along:
            read = np.isfinite(measured + levers[run]) & known[:, None]
            # In the order of time, several readings of one row side by side.
            full, column = np.nonzero(read)
            lever = levers[run][full, column][:, None]
            measured = measured[full, column][:, None]
            values = np.hstack((values[full], rules.slope_gain * lever, lever * values[full]))
        else:
            full = np.flatnonzero(np.isfinite(measured).all(axis=1) & known)
            values, measured = values[full], measured[full]
        if not full.size:
            continue
        rows.append(run.start + full)
        inputs.append(values)
        outputs.append(measured)
    if not inputs:
        raise InputError("log: no row has every displacement; record them together")
    return Design(np.concatenate(rows), within_runs(inputs), within_runs(outputs))


def known_rows(cleaned: Cleaned, run: slice, rules: Features) -> NDArray[np.bool_]:
    """Return which rows of a run are independent of earlier heat, shape (k,) of bool.

    A run that starts at standstill is assumed to start at rest.
    """
    times = cleaned.table.times[run]
    since = times - times[0]
    warm = any(
        abs(cleaned.at(name)[run][0]) > rules.standstill * np.abs(cleaned.at(name)).max()
        for name in cleaned.drives
    )
    return np.asarray(since >= min(rules.before, rules.given_up * since[-1]) * warm)


def within_runs(runs: list[Array]) -> Array:
    """Return the rows of all runs, each run shifted to the common mean."""
    whole = np.concatenate(runs)
    if len(runs) == 1:
        return whole
    return np.concatenate([run - run.mean(axis=0) for run in runs]) + whole.mean(axis=0)


def sizes(features: tuple[Feature, ...], rules: Features) -> Array:
    """Return the a priori size of each weight, µm, shape (n,)."""
    return np.array([rules.heat_gain if one.exponent else rules.gain for one in features])


def slope_sizes(size: Array, lever: float, rules: Features) -> Array:
    """Return the a priori sizes of K0's weights, µm, of the constant slope and the slope's, µm/m.

    `lever` is the longest distance from the reference position, m.
    """
    return np.concatenate((size, [rules.slope_gain / lever], size / lever))
