"""The floor of one machine, mill, and its store, for the tests of what a service does and keeps."""

from thermojoint.live import floor as floors
from thermojoint.live.floor import Floor, Place
from thermojoint.live.log_lines import EventLog
from thermojoint.live.machine_state import at_rest
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.settings import WatchdogSection
from thermojoint.live.store import Batch, commit, era_of


def floor_of(model, store, now):
    era = era_of(store, "mill", model.digest, model.layout, now)
    place = Place(model, era, at_rest("mill", model, now), None, now)
    return Floor({"mill": place}, EventLog(), fresh_metrics(), 60.0, 60.0, WatchdogSection())


def keep(floor, store, arrival):
    """What arrived is taken when it was told, and committed."""
    outcome = floors.absorb(floor, [arrival], arrival.time, arrival.time)
    told = floors.received(floor, outcome.publications, arrival.time)
    commit(store, Batch(outcome.taken, (), floor.log.fetched(), outcome.holes, told))
