"""The estimator of Figure 5 as a stream: temperatures in, heat and displacement out.

One sample passes seven blocks:

1. ΔT -> Q̂, the inverse of the regularised thermal model (Eqs. 3-6);
2. Q̂ -> δ_L, the linear displacement (Eq. 8), for each axis;
3. Q̂ -> T_lin, what the sensors at the joint would read on the linear structure;
4, 5. ∂T = T - T_lin -> q̂, the strengths of the fictitious sources, by one matrix inverse (Eq. 16);
6, 7. q̂ -> δ_NL (Eq. 18), for each axis; δ = δ_L + δ_NL.

Between samples the temperatures are interpolated linearly, and Q̂ (likewise q̂) at a sample is the
**mean heat over the interval that has just ended**. It drives the following blocks as a constant
over that interval. So the heat of any sample is exactly that of the interpolated temperatures, for
any intervals, and a step that starts at a sample is not delayed. Before the first sample the
structure is at rest for one nominal interval, in which the temperatures rise to their first values.

All blocks together are linear, so a sample at a given interval is one product of a precomputed
matrix with (state, measured values). The state is a plain array; there is no other memory.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.cells import LARGEST_TEMPERATURE
from thermojoint.models.assembly import Assembly
from thermojoint.models.filters.bank import over_interval

#: Index of the time of the last sample in a state; the readings and the banks follow it.
TIME = 0


class Signals(NamedTuple):
    """Outputs of the blocks at one sample, or at many (arrays with a leading time axis)."""

    #: s.
    time: float | np.ndarray
    #: Q̂, mean over the interval just ended, 1.
    heat: float | np.ndarray
    #: Shape (..., n): q̂, mean over the interval just ended, 1.
    sources: np.ndarray
    #: Shape (..., n): ∂T at the sample, K.
    deviation: np.ndarray
    #: Shape (..., n_axes): δ_L, δ_NL and their sum, m.
    linear: np.ndarray
    nonlinear: np.ndarray
    total: np.ndarray


def initial_state(assembly: Assembly) -> np.ndarray:
    """Return the state of a structure at rest at ambient temperature, before any sample.

    A state is (time of the last sample, last ΔT, last ∂T, states of the banks); here the time is
    NaN.
    """
    state = np.zeros(assembly.n_state)
    state[TIME] = np.nan
    return state


def step(
    assembly: Assembly, state: np.ndarray, time: float, delta_T: float, *temperatures: float
) -> tuple[np.ndarray, Signals]:
    """Take one sample.

    Parameters
    ----------
    assembly : Assembly
    state : ndarray, shape (assembly.n_state,)
        From `initial_state` or the previous step; not modified.
    time : float
        s, later than that of the previous sample.
    delta_T : float
        T_a - T_b, K.
    *temperatures : float
        T1, T2, ...: rise above the current ambient at the joint, K.

    Returns
    -------
    state : ndarray
        The new state.
    signals : Signals

    Raises
    ------
    InputError
        Time does not increase, or a value is not finite or missing. The state can be used again.
    """
    if not math.isfinite(time):
        raise InputError(
            f"sample at t = {time:.15g} s: its time is not finite; leave the sample out"
        )
    last = state[TIME]
    dt = assembly.dt_s if math.isnan(last) else time - float(last)
    if not 0.0 < dt < math.inf:
        raise InputError(
            f"sample at t = {time:.15g} s: time does not increase (the last was at {last:.15g} s); "
            "drop or re-order the sample"
        )
    measured = (delta_T, *temperatures)
    if len(measured) != 1 + assembly.n_sources or not all(map(_possible, measured)):
        raise _unusable(assembly, time, measured)
    result = propagator(assembly, dt) @ np.concatenate((state[TIME + 1 :], measured))
    # np.split would take longer.
    sources, axes, heat = assembly.n_sources, len(assembly.axes), state.size - 1
    last = heat + 1 + sources
    inner, strengths = result[:heat], result[heat + 1 : last]
    linear, nonlinear = result[last : last + axes], result[last + axes :]
    deviation = inner[1 : 1 + sources]
    return np.concatenate(([time], inner)), Signals(
        time, float(result[heat]), strengths, deviation, linear, nonlinear, linear + nonlinear
    )


def run(
    assembly: Assembly,
    times: np.ndarray,
    delta_T: np.ndarray,
    temperatures: np.ndarray,
    state: np.ndarray | None = None,
) -> tuple[Signals, np.ndarray]:
    """Process a block of samples, with the same bits as successive calls of `step`.

    Parameters
    ----------
    assembly : Assembly
    times, delta_T : ndarray, shape (k,)
        s and K.
    temperatures : ndarray, shape (k, n)
        K.
    state : ndarray, optional
        State after the previous block; by default at rest.

    Returns
    -------
    signals : Signals
        Arrays with a leading axis of length k.
    state : ndarray
        The state after the last sample.

    Raises
    ------
    InputError
        As `step`, with the number of the sample (from 0); or the shapes do not agree, there are no
        samples, or the state belongs to another assembly.
    """
    shapes = np.shape(times), np.shape(delta_T), np.shape(temperatures)
    count = len(times)
    if shapes != ((count,), (count,), (count, assembly.n_sources)):
        raise InputError(
            f"samples: time, ΔT and T have shapes {shapes}; expected (k,), (k,) and "
            f"(k, {assembly.n_sources})"
        )
    table = np.column_stack((times, delta_T, temperatures))
    state = initial_state(assembly) if state is None else state
    if not len(table):
        raise InputError("no samples; give at least one")
    if np.shape(state) != (assembly.n_state,):
        raise InputError(
            f"state of shape {np.shape(state)}, expected {(assembly.n_state,)}; it belongs to "
            "another estimator"
        )
    found: list[Signals] = []
    for index, sample in enumerate(table.tolist()):
        try:
            state, signals = step(assembly, state, *sample)
        except InputError as error:
            raise InputError(f"sample {index}: {error}") from error
        found.append(signals)
    return Signals(*(np.array(column) for column in zip(*found, strict=True))), state


@lru_cache(maxsize=64)
def propagator(assembly: Assembly, dt: float) -> np.ndarray:
    """Return the matrix of one sample over an interval of `dt` s.

    It takes (last ΔT, last ∂T, states; ΔT, T) to (ΔT, ∂T, states; Q̂, q̂, δ_L, δ_NL).
    """
    n = assembly.n_sources
    sizes = [1, n, *(bank.n_state for bank in assembly.banks), 1, n]
    width = sum(sizes)
    rows = np.split(np.eye(width), np.cumsum(sizes)[:-1])
    old_difference, old_deviation, x_heat, x_linear, x_temp, x_sources, x_nonlinear = rows[:7]
    difference, measured = rows[7:]
    heat, linear, temp, sources, nonlinear = (over_interval(b, dt) for b in assembly.banks)

    q_main = heat.mean @ x_heat + heat.mean_old @ old_difference + heat.mean_new @ difference
    x_heat = heat.advance @ x_heat + heat.old @ old_difference + heat.new @ difference
    x_linear = linear.advance @ x_linear + (linear.old + linear.new) @ q_main
    x_temp = temp.advance @ x_temp + (temp.old + temp.new) @ q_main
    deviation = measured - temp.end @ x_temp
    q_joint = (
        sources.mean @ x_sources + sources.mean_old @ old_deviation + sources.mean_new @ deviation
    )
    x_sources = sources.advance @ x_sources + sources.old @ old_deviation + sources.new @ deviation
    x_nonlinear = nonlinear.advance @ x_nonlinear + (nonlinear.old + nonlinear.new) @ q_joint
    matrix = np.concatenate(
        (
            difference,
            deviation,
            x_heat,
            x_linear,
            x_temp,
            x_sources,
            x_nonlinear,
            q_main,
            q_joint,
            linear.end @ x_linear,
            nonlinear.end @ x_nonlinear,
        )
    )
    matrix.flags.writeable = False
    return matrix


def _unusable(assembly: Assembly, time: float, measured: tuple[float, ...]) -> InputError:
    """Return the error that names the channel."""
    names = ["ΔT", *(f"T{j + 1}" for j in range(assembly.n_sources))]
    where = f"sample at t = {time:.15g} s"
    if len(measured) != len(names):
        return InputError(f"{where}: {len(measured)} values, expected {', '.join(names)}")
    name, bad = next(pair for pair in zip(names, measured, strict=True) if not _possible(pair[1]))
    wrong = f"is {bad:g} K, no temperature" if math.isfinite(bad) else "is not finite"
    return InputError(f"{where}: {name} {wrong}; leave the sample out, gaps are allowed")


def _possible(value: float) -> bool:
    """Whether a value can be a temperature, K; NaN cannot."""
    return abs(value) <= LARGEST_TEMPERATURE
