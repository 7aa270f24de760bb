"""Heat that comes from no source of a case, on the modes of its machine.

Guides and seals rub, motors warm their mounts, a door opens, air is warmer at the top. An observer
without such heat attributes it to the sources or to their past.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Modes, ReducedMachine, diagonal_modes


def with_unknown_heat(
    machine: ReducedMachine, held: Array | None, lasts: float
) -> tuple[Modes, Array]:
    """Return diagonal modes with one more for the heat of every face, and the noise of a step.

    The heat q of a face is a Gauss-Markov process, dq/dt = -q / lasts + w, and drives the
    amplitudes, da/dt + rates a = b q + ... With c = b / (rates - 1 / lasts), q and a - c q relax
    independently: q is one more mode, and rows C on a become [C, C c]. So the equations stay
    diagonal, those of an implicit step included, and code that marches or reads modes treats those
    of heat like any other.

    Parameters
    ----------
    machine : ReducedMachine
        With the parameters of a fit.
    held : ndarray, shape (m,), optional
        Conductance of the joints that belongs to the modes, W/K.
    lasts : float
        Time constant of the heat, s.

    Returns
    -------
    tuple of (Modes, ndarray of shape (r + b, b))
        The modes, and their change in a step of `machine.step` per W of standard deviation of the
        heat of each face: one standard deviation, independent of the others.
    """
    # Several thermometers may be on one face.
    heated = np.unique(machine.faces[:, machine.faces.any(axis=0)], axis=1)
    faces, known = heated.shape[1], machine.power.size
    whole = replace(
        machine,
        sources=np.hstack([machine.sources, heated]),
        power=np.append(machine.power, np.ones(faces)),
    )
    modes = diagonal_modes(whole, held)
    rate = _apart(modes.rates, 1.0 / lasts)
    own = np.s_[known : known + faces]
    shares = modes.drive[:, own] / (modes.rates - rate)[:, None]
    # Amplitudes of heat are scaled to their effect on those of the machine.
    size = np.linalg.norm(shares, axis=0)
    shares = shares / size

    def rows(of: Array) -> Array:
        return np.asarray(np.hstack([of, of @ shares]))

    def driven(columns: Array) -> Array:
        return np.pad(columns, ((0, faces), (0, 0)))

    kept, keeps = 1.0 / (1.0 + machine.step * modes.rates), 1.0 / (1.0 + machine.step * rate)
    added = np.vstack([-shares * kept[:, None] / keeps, np.eye(faces)])
    known_only = replace(modes, drive=np.delete(modes.drive, own, axis=1))
    found = known_only.with_more(np.full(faces, rate), rows, driven)
    found = replace(found, film=driven(rows(modes.film)))
    return found, added * size * np.sqrt(1.0 - keeps**2)


def _apart(rates: Array, rate: float) -> float:
    """Return the rate, 1/s, that is furthest from those of modes, up to twice as fast or as slow.

    Next to the rate of a mode, both terms would be large and cancel.
    """
    tried = rate * np.geomspace(0.5, 2.0, 65)
    gaps = np.abs(np.log(rates[rates > 0.0] / tried[:, None])).min(axis=1)
    return float(tried[gaps.argmax()])
