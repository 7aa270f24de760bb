"""Powers that a sample reads: heat of sources that is known before the thermometers detect it."""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import ObserverState
from thermojoint.artefacts.arrays import Array, Flags


def most_power(observer: Observer) -> Array:
    """Return the largest plausible power, of either sign, W, shape (t,)."""
    model = observer.model
    most = observer.thresholds.implausible_heat * model.calibrated.heat * model.power
    shares = model.power_shares.items()
    return np.array([most[model.sources.index(source)] / share for source, share in shares])


def change_heat(observer: Observer, own: ObserverState, powers: Array) -> None:
    """Change the heat by the powers (t,), W, since the previous sample, in place.

    The thermometers correct it as usual, for errors of a share and for heat that is not part of any
    power.
    """
    shares = observer.model.power_shares.values()
    for k, (at, share) in enumerate(zip(_places(observer), shares, strict=True)):
        if np.isnan(powers[k]):
            continue
        heat = share * powers[k]
        change = heat - own.power_heat[k]
        own.linear[at] += change
        if np.isfinite(own.pending.channel):
            own.pending.linear[at] += change
        own.power_heat[k] = heat


def attribute_heat(
    observer: Observer, before: ObserverState, after: ObserverState, unread: Flags
) -> None:
    """Attribute heat found by thermometers in a sample to missing powers (t,), in place.

    It would be counted twice otherwise when a power is read again.
    """
    found = after.linear - before.linear
    after.power_heat[unread] += found[_places(observer)][unread]


def _places(observer: Observer) -> list[int]:
    """Indices (t,) of their sources' heat in the linear state."""
    first, model = observer.heat.start, observer.model
    return [first + model.sources.index(source) for source in model.power_shares]
