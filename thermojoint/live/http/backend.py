"""What the HTTP server shows of the service, and the actions that it offers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from prometheus_client import CollectorRegistry

from estimator.ranges import Range
from thermojoint.live.archive import Archive
from thermojoint.live.former_models import Deployment
from thermojoint.live.publication import Layout
from thermojoint.live.publisher import Publisher
from thermojoint.live.scene import Scene


@dataclass(frozen=True)
class MachineInfo:
    """Constant data of a machine while the service runs."""

    layout: Layout
    kind: str
    #: Name of the model's file.
    model: str
    #: Time since which it runs on this model, s since 1970.
    since: float
    #: Calibrated ranges of the model.
    valid: tuple[Range, ...] = ()
    #: Its displacement readings: ``x_um``.
    probes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Backend:
    """Data and actions of the service."""

    publisher: Publisher
    archive: Archive
    machines: Mapping[str, MachineInfo]
    registry: CollectorRegistry
    #: 3-D scenes of the machines that have one.
    scenes: Mapping[str, Scene]
    #: Residuals (reading minus model, K) of the machines whose estimator predicts readings; None
    #: before the first sample.
    residuals: Mapping[str, Callable[[], dict[str, float | None] | None]]
    #: Answers of the controls, for the machines with a handshake.
    handshakes: Mapping[str, Callable[[], dict[str, Any]]] = field(default_factory=dict)
    #: Machine to the last model before its present one; None without any.
    former: Callable[[str], Deployment | None] = lambda machine: None
    #: Rolls a machine back to that model.
    roll_back: Callable[[str], object] = lambda machine: None
    #: Machines whose controls answer the handshake by HTTP: the only user who may answer (None: any
    #: user who may write), and the function that receives the answer.
    controls: Mapping[str, tuple[str | None, Callable[[bytes], None]]] = field(default_factory=dict)
    #: Postpones the displacement reading requested for a machine.
    postpone: Callable[[str], object] = lambda machine: None
    #: Receives displacement readings of a machine, name to value, um; False if the queue is full.
    read: Callable[[str, Mapping[str, float]], bool] = lambda machine, given: False
    #: State of the disk for the health check.
    disk: Callable[[], dict[str, str | float]] = dict
