"""A fleet of one machine, mill, and its store, for the tests of what a service does and keeps."""

from thermojoint.live import processing
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import initial_state
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.processing import Fleet, Machine
from thermojoint.live.settings import WatchdogSection
from thermojoint.live.store import Batch, commit, era_of


def fleet_of(model, store, now):
    era = era_of(store, "mill", model.digest, model.layout, now)
    mill = Machine(model, era, initial_state("mill", model, now), None, now, now)
    return Fleet({"mill": mill}, EventLog(), fresh_metrics(), 60.0, 60.0, WatchdogSection())


def keep(fleet, store, arrival):
    """What arrived is taken when it was told, and committed."""
    results = processing.process(fleet, [arrival], arrival.time, arrival.time)
    told = processing.received_offsets(fleet, results.publications, arrival.time)
    commit(store, Batch(results.samples, (), fleet.log.take_pending(), results.gaps, told))
