"""Settings of a service that are valid by themselves but contradict each other or the model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress

import numpy as np

from estimator.lines import lines_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.output import OutputSettings, band_along
from thermojoint.compensation.offsets.usable import limit_without_band
from thermojoint.live.loaded_models import LoadedModel
from thermojoint.live.settings import ServiceFile


def contradictions(given: ServiceFile, models: Mapping[str, LoadedModel]) -> Iterator[str]:
    """Yield a warning for each setting by which values never stay good."""
    for name, model in models.items():
        if given.watchdog.uncertain_s < model.rule.interval:
            yield (
                f"watchdog.uncertain_s {given.watchdog.uncertain_s:g} is shorter than interval_s "
                f"{model.rule.interval:g} of models.{name}: values become uncertain between samples"
            )
        if model.output is None:
            continue
        band = _band_at_first(model, model.output.output)
        widest = model.output.trust.widest_band
        if unlimited := limit_without_band(model.output.trust, band):
            yield f"models.{name}: {unlimited}"
        if bool((band > widest).any()):
            yield (
                f"models.{name}: widest_band_um {widest / MICRO:g} is narrower than the model's "
                f"own band, {np.nanmax(band) / MICRO:.3g} um at a start: no offset follows while "
                "it is"
            )


def _band_at_first(model: LoadedModel, output: OutputSettings) -> Array:
    """Return the followed bands (m) of a first sample with all readings missing, or all zero."""
    count, axes = len(model.estimator.channels), model.layout.axes
    for value in (np.nan, 0.0):
        with suppress(ThermojointError):
            start = model.estimator.initial_state()
            _, first = model.estimator.sample(start, 0.0, [value] * count)
            lines = lines_of(axes, model.layout.details, first.details)
            return band_along(output, axes, first.band, lines)
    return np.full(len(output.names), np.nan)
