"""Data sources of the HTTP server."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

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
        Names of its published values.
    kind : str
        Kind of its estimator.
    model : str
        Name of the model's file.
    since : float
        When it began to run on this model, s since 1970.
    valid : tuple of Range
        Calibrated ranges of the model.
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
        Newest publications.
    past : Archive
        History and events.
    machines : mapping
        Name to its constant data.
    registry : CollectorRegistry
        Metrics for Prometheus.
    scenes : mapping
        3-D scenes of the machines that have one.
    residuals : mapping
        Residuals (reading minus model, K) of the machines whose estimator predicts readings; None
        before the first sample.
    handshakes : mapping
        What the controls have said, of the machines that have a handshake.
    former : callable
        Machine to the last model before its present one; None without any.
    roll_back : callable
        Makes a machine go back to that model.
    controls : mapping
        The machines whose controls answer here (the handshake): the only user who may, None for
        any that may write, and what takes the answer.
    postpone : callable
        Postpones the displacement reading that a machine asks for; False if it asks for none.
    disk : callable
        What the health check says of the disk.
    """

    hub: Hub
    past: Archive
    machines: Mapping[str, About]
    registry: CollectorRegistry
    scenes: Mapping[str, Scene]
    residuals: Mapping[str, Callable[[], dict[str, float | None] | None]]
    handshakes: Mapping[str, Callable[[], dict[str, Any]]] = field(default_factory=dict)
    former: Callable[[str], Deployment | None] = lambda machine: None
    roll_back: Callable[[str], object] = lambda machine: None
    controls: Mapping[str, tuple[str | None, Callable[[bytes], None]]] = field(default_factory=dict)
    postpone: Callable[[str], bool] = lambda machine: False
    disk: Callable[[], dict[str, str | float]] = dict
