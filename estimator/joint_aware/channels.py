"""Channels of a sample, and details of an estimate, by name and unit."""

from __future__ import annotations

from estimator import lines
from estimator.interface import Channel
from estimator.joint_aware.observer_model import ObserverModel


def sample_channels(model: ObserverModel) -> tuple[Channel, ...]:
    """Return the contents of a sample, in order: see `JointAware.channels`."""
    return (
        *(Channel(name, "K") for name in (*model.sensors, "ambient")),
        *(Channel(name, "1") for name in model.loads),
        *(Channel(name, "m") for name in (*model.positions, *model.ways)),
        *(Channel(name, "W") for name in model.powers),
        *(Channel(f"displacement_{axis}", "m", occasional=True) for axis in model.axes),
    )


def estimate_details(model: ObserverModel) -> tuple[Channel, ...]:
    """Return the contents of an estimate, beside the displacement: see `JointAware.details`."""
    along = [axis.name for axis in model.moving_axes]
    asked = [axis.asked for axis in model.moving_axes]
    return (
        *(Channel(f"heat_{name}", "W") for name in model.sources),
        *(Channel(f"held_{name}", "K") for name in model.surfaces),
        Channel("ambient", "K"),
        Channel("lowest_pressure", "Pa"),
        Channel("highest_pressure", "Pa"),
        *(
            one
            for axis, k in model.sloped.items()
            for one in (
                *lines.channels_of(axis),
                *lines.channels_here(axis),
                *lines.channels_at(axis, asked[k]),
            )
        ),
        *(
            Channel(f"{axis}_{name}_{moving}", unit)
            for axis in model.axes
            for moving in along
            if len(along) > 1
            for name, unit in lines.ALONG
        ),
    )
