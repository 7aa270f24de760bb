"""Data sources of the HTTP server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from prometheus_client import CollectorRegistry

from estimator.ranges import Range
from thermojoint.live.archive import Archive
from thermojoint.live.former_models import Deployment
from thermojoint.live.hub import Hub
from thermojoint.live.publication import Layout
from thermojoint.live.scene import Scene


@dataclass(frozen=True)
class About:
    """Constant data of a machine while the service runs.

    Attributes
    ----------
    layout : Layout
        Names of all that is published of it.
    kind : str
        Of its estimator.
    model : str
        Name of the model's file.
    since : float
        When the service began to run it on this model, s since 1970.
    valid : tuple of Range
        What the model was calibrated for.
    """

    layout: Layout
    kind: str
    model: str
    since: float
    valid: tuple[Range, ...] = ()


@dataclass(frozen=True, eq=False)
class Sources:
    """Data shown by the server.

    Attributes
    ----------
    hub : Hub
        The newest of every machine.
    past : Archive
        History and events.
    machines : mapping
        Name to what stays of it.
    registry : CollectorRegistry
        For Prometheus.
    scenes : mapping
        Machines that have a picture in 3-D.
    residuals : mapping
        Machines whose estimator says what a reading should be; reading minus model, K, by reading,
        None before the first sample.
    former : callable
        Machine to the last model before its present one; None without any.
    roll_back : callable
        Makes a machine go back to that model.
    """

    hub: Hub
    past: Archive
    machines: Mapping[str, About]
    registry: CollectorRegistry
    scenes: Mapping[str, Scene]
    residuals: Mapping[str, Callable[[], dict[str, float | None] | None]]
    former: Callable[[str], Deployment | None] = lambda machine: None
    roll_back: Callable[[str], object] = lambda machine: None
