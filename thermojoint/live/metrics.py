"""Figures of a running service for Prometheus."""

from __future__ import annotations

from dataclasses import dataclass

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector

#: Bounds of the histograms, s.
_SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0, 30.0)


@dataclass(frozen=True, eq=False)
class Metrics:
    """Counters of one service."""

    #: Registry of all metrics, for ``/metrics``.
    registry: CollectorRegistry
    #: Samples by model; arrivals by verdict; events by kind.
    samples: Counter
    arrivals: Counter
    events: Counter
    #: Time from an arrival to its publication; duration of a transaction, s.
    latency: Histogram
    commit: Histogram
    #: Machines by quality.
    quality: Gauge
    #: Time of the offsets of each machine in each mode, s.
    modes: Counter
    #: Requested displacement readings, by machine and outcome.
    next_readings: Counter
    #: Arrivals in the queue; size of the store's write-ahead log, bytes.
    waiting: Gauge
    log_size: Gauge
    #: 1 if the disk of the store is full; time for which the store's own reserve lasts, s.
    disk_full: Gauge
    reserve: Gauge


def fresh_metrics() -> Metrics:
    """Return metrics at zero."""
    registry = CollectorRegistry()
    ProcessCollector(registry=registry)

    def counter(name: str, text: str, *labels: str) -> Counter:
        return Counter(name, text, labels, registry=registry)

    def gauge(name: str, text: str, *labels: str) -> Gauge:
        return Gauge(name, text, labels, registry=registry)

    def histogram(name: str, text: str) -> Histogram:
        return Histogram(name, text, buckets=_SECONDS, registry=registry)

    arrivals = "Readings that arrived: taken, late, ahead, no-time."
    modes = "Time in which offsets followed, froze, decayed or waited."
    next_readings = "Displacement readings: asked, taken, postponed, withdrawn."
    latency = "From the arrival of a sample to its publication."
    reserve = "How long the store can go on within its file."
    return Metrics(
        registry,
        counter("thermojoint_samples", "Samples taken.", "model"),
        counter("thermojoint_arrivals", arrivals, "verdict"),
        counter("thermojoint_events", "Events by kind.", "kind"),
        histogram("thermojoint_latency_seconds", latency),
        histogram("thermojoint_commit_seconds", "One transaction of the store."),
        gauge("thermojoint_machines", "Machines by quality.", "quality"),
        counter("thermojoint_offset_seconds", modes, "machine", "mode"),
        counter("thermojoint_next_readings", next_readings, "machine", "outcome"),
        gauge("thermojoint_waiting", "Arrivals that wait for their turn."),
        gauge("thermojoint_store_log_bytes", "Size of the write-ahead log."),
        gauge("thermojoint_disk_full", "1 if the disk of the store is full."),
        gauge("thermojoint_store_reserve_seconds", reserve),
    )
