"""Logs of a machine whose physics is known: a spindle's heat, a room that changes, growth."""

import numpy as np

from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.filters.relaxations import relax_all

NAMES = ("n_rpm", "x_um", "z_um", *(f"T{k}_degC" for k in range(1, 7)))
#: Time constants of the temperatures, s, and how much of heat and of the room each sees.
TAUS = np.array([600.0, 1800.0, 3600.0, 7200.0, 900.0, 300.0])
HEAT = np.array([12.0, 8.0, 5.0, 3.0, 0.5, 0.0])
ROOM = np.array([0.2, 0.3, 0.5, 0.6, 0.9, 1.0])


def speeds(times, seed=0):
    """Levels held for one to three hours."""
    draw = np.random.default_rng(seed)
    found, now = np.zeros_like(times), 0
    while now < len(times):
        hold = int(draw.uniform(3600, 10800) / (times[1] - times[0]))
        found[now : now + hold] = draw.choice([0.0, 0.0, 1500.0, 2500.0, 3500.0])
        now += hold
    return found


def machine_log(hours=14.0, interval=60.0, seed=0, start=0.0, noise=0.02):
    """A log of two displacements (µm) that temperatures and speed explain."""
    times = start + np.arange(0.0, hours * 3600.0, interval)
    draw = np.random.default_rng(seed + 100)
    speed = speeds(times, seed)
    heat = (speed / 3500.0) ** 1.5
    room = 1.5 * np.sin(2 * np.pi * times / 40000.0) + 0.5 * np.sin(2 * np.pi * times / 9000.0)
    own = relax_all(times, np.outer(heat, HEAT), TAUS, np.zeros(6))
    own += relax_all(times, np.outer(room, ROOM), TAUS, room[0] * ROOM)
    # An expansion of the spindle that no thermometer sees, beside what they see.
    grown = relax_all(times, heat[:, None], np.array([900.0]), np.zeros(1))[:, 0]
    x = 1.2 * own[:, 0] + 2.0 * own[:, 4] + 6.0 * grown
    z = 3.0 * own[:, 2] - 4.0 * own[:, 5]
    values = np.column_stack((speed, x, z, 25.0 + own))
    values[:, 1:] += noise * draw.standard_normal(values[:, 1:].shape)
    return made(times, NAMES, values)


def made(times, names, values):
    """A log from values as a logger writes them."""
    columns = tuple(column_named(name) for name in names)
    si = [one.to_si(column) for one, column in zip(columns, values.T, strict=True)]
    return Log(times, columns, np.stack(si, axis=1))


def along_log(hours=14.0, seed=0, start=0.0, every=10, reach_mm=200.0, moved_hours=1e9):
    """`machine_log` with x read every so many samples at y_pos_mm; its K0 at 50 mm, µm, and slope.

    The slope, µm/m, grows with z; after `moved_hours` the axis stands.
    """
    log = machine_log(hours, seed=seed, start=start)
    draw = np.random.default_rng(seed + 7)
    k0, slope = 1e6 * log.at("x_um"), 80.0 + 10e6 * log.at("z_um")
    position = 50.0 + draw.uniform(-reach_mm, reach_mm, len(k0))
    position[log.times - start > 3600.0 * moved_hours] = 50.0
    read = k0 + 1e-3 * slope * (position - 50.0) + 0.3 * draw.standard_normal(len(k0))
    read[np.arange(len(read)) % every != 0] = np.nan
    columns = [own.from_si(log.at(own.name)) for own in log.columns]
    columns[1] = read
    return made(log.times, (*NAMES, "y_pos_mm"), np.column_stack((*columns, position))), k0, slope


def as_csv(log, path, names=None):
    """Write a log as a logger would."""
    kept = [k for k, name in enumerate(log.names) if names is None or name in names]
    cells = [log.columns[k].from_si(log.values[:, k]) for k in kept]
    rows = np.column_stack((log.times, *cells))
    head = ",".join(["time_s", *(log.names[k] for k in kept)])
    lines = [",".join("" if np.isnan(one) else f"{one:.4f}" for one in row) for row in rows]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    return path


def changed(log, name, function):
    """The log with one column changed."""
    values = log.values.copy()
    k = log.index(name)
    values[:, k] = function(values[:, k].copy())
    return Log(log.times, log.columns, values, log.starts)
