"""Band and actual error against the number of sensors, on plants that are not the model.

The model stands on a 50/25 mm mesh, the plants on a 40/20 mm mesh with parameters drawn from their
priors by a seed that the placement does not see. Each plant is calibrated from its own steps of
0.5, 1 and 2 and judged over a day of 8 h of random heat and ambient, temperatures alone. Sensors
are placed by `calibrate.placement.joint_aware`, by PySensors (QR pivots on the temperatures of a
day) and at random.

    pip install python-sensors
    python -m benchmarks.sensor_count --out sensor_count.json --plot sensor-count.png
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.hand_placed import MODEL, PLACES, PLANT, machine_data
from benchmarks.plants.judging import with_sensors
from benchmarks.study import options_of, write_json
from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.misfit import Run
from calibrate.joint_aware.physics_fit import Fit, fit_physics
from calibrate.joint_aware.random_heat import random_levels
from calibrate.placement import joint_aware as placement
from calibrate.placement import plant_family
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_model import Calibrated
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import (
    ReducedMachine,
    along,
    diagonal_modes,
    reduce_machine,
)
from thermojoint.reduced.parameters import active, factors_of, with_factors
from thermojoint.reduced.physics import make_physics, simulate_known

#: Step of plants and observers, s; judged plants and their seed.
STEP, PLANTS, SEED = 10.0, 4, 11
MOST, LEVELS, CALIBRATED = 8, (0.5, 1.0, 2.0), 2100.0
#: Boxes around the source and in the strips, mm; the source's top is at 690 mm.
BOXES = (
    ([500.0, 350.0, 0.0], [600.0, 850.0, 200.0], 50.0),
    ([625.0, 350.0, 50.0], [650.0, 750.0, 125.0], 50.0),
)
#: Sets at random of every number.
RANDOM = 1


def candidates_on(sizes: tuple[float, float]) -> ReducedMachine:
    """Return the machine on a mesh, with every candidate as a sensor."""
    data = machine_data(690.0, sizes)
    data["candidates"] = [
        {"body": "column", "low_mm": low, "high_mm": high, "spacing_mm": spacing}
        for low, high, spacing in BOXES
    ]
    case = case_from_data(data, "benchmark", Path())
    setup = set_up(case)
    machine = along(reduce_machine(case, setup, list(setup.probes)), ["x", "y"])
    return plant_family.fewer_modes(replace(machine, step=STEP), plant_family.Drawing(step=STEP))


def answers(machine: ReducedMachine, inputs: Array) -> tuple[Array, Array]:
    """March from rest."""
    held = machine.at_preload
    physics = make_physics(diagonal_modes(machine, held), machine.joints, held)
    return simulate_known(physics, inputs, STEP)


class Plant:
    """One drawn plant: its calibration runs and its day, with every candidate."""

    def __init__(self, machine: ReducedMachine, day: Array) -> None:
        count = round(CALIBRATED / STEP)
        times = STEP * np.arange(1.0, count + 1.0)
        self.names = machine.sensor_names
        self.runs = []
        for level in LEVELS:
            inputs = np.tile(np.append(level * machine.power, 0.0), (count, 1))
            self.runs.append(Run(inputs, times, *answers(machine, inputs), STEP))
        self.day = answers(machine, day)

    def seen(self, names: Sequence[str]) -> list[Run]:
        """The calibration runs by some sensors."""
        at = [self.names.index(name) for name in names]
        return [replace(run, temperature=run.temperature[:, at]) for run in self.runs]


def drawn(machine: ReducedMachine, rng: np.random.Generator) -> ReducedMachine:
    """Return a machine with parameters drawn from their priors."""
    parameters = active(machine)
    spread = np.array([one.spread for one in parameters])
    return with_factors(machine, factors_of(parameters, spread * rng.normal(size=spread.size)))


def error(
    model: ReducedMachine, plant: Plant, fit: Fit, names: Sequence[str], ambient: Array
) -> Array:
    """Largest error over the day, m, (axes,): the fitted machine, a remainder for these sensors."""
    fitted = with_sensors(with_factors(model, factors_of(fit.parameters, fit.coordinates)), names)
    runs = plant.seen(names)
    beside = fit_physics(fitted, runs, [])
    known = Calibrated(CALIBRATED, 2.0, dict.fromkeys(names, (0.0, 100.0)))
    observer = JointAware(make_observer(fitted, beside, known))
    at = [plant.names.index(name) for name in names]
    readings = np.column_stack([plant.day[0][:, at], ambient])
    samples = ((STEP * (k + 1), *row) for k, row in enumerate(readings))
    found = [one.displacement for _, one in follow(observer, samples, observer.initial_state())]
    wrong = np.abs(np.array(found) - plant.day[1]).max(axis=0)
    return np.asarray(wrong)


def sets_of(
    model: ReducedMachine, family: plant_family.Family, day: Array
) -> dict[str, list[tuple[str, ...]]]:
    """Return the sets of sensors to be judged, by how they were found."""
    # Not at the top: other benchmarks use the machines of this one, and do without it.
    from pysensors import SSPOR
    from pysensors.basis import SVD

    names = model.sensor_names
    grown = [step.names for step in placement.place_sensors(model, MOST, family=family).steps]
    temperatures, _ = answers(model, day)
    pivots = SSPOR(basis=SVD(n_basis_modes=MOST), n_sensors=MOST)
    pivots.fit(temperatures)
    order = [names[k] for k in pivots.get_selected_sensors()]
    rng = np.random.default_rng(SEED)
    some = [
        tuple(rng.choice(names, size=count, replace=False))
        for count in range(1, MOST + 1)
        for _ in range(RANDOM)
    ]
    return {
        "placed": grown,
        "PySensors": [tuple(order[:count]) for count in range(1, MOST + 1)],
        "at random": some,
        "by hand": [tuple(PLACES)],
    }


def study() -> dict[str, Any]:
    """Return all figures."""
    model, other = candidates_on(MODEL), candidates_on(PLANT)
    rng = np.random.default_rng(SEED)
    heat = random_levels(rng, plant_family.USUAL.duration, STEP, 2.0, model.power.size)
    ambient = np.cumsum(rng.normal(size=len(heat)))
    ambient *= 3.0 / np.abs(ambient).max()
    day = np.column_stack([heat * model.power, ambient])
    family = plant_family.make_family(model)
    sets = sets_of(model, family, day)
    plants = [Plant(drawn(other, rng), day) for _ in range(PLANTS)]
    fits = [
        fit_physics(with_sensors(model, list(PLACES)), one.seen(list(PLACES))) for one in plants
    ]
    rows = []
    for how, chosen in sets.items():
        for names in chosen:
            band = placement.place_sensors(model, len(names), names, family).chosen.band
            for number, (plant, fit) in enumerate(zip(plants, fits, strict=True)):
                wrong = error(model, plant, fit, names, ambient)
                rows.append(
                    {
                        "how": how,
                        "count": len(names),
                        "sensors": list(names),
                        "plant": number,
                        "band_um": (1e6 * band).tolist(),
                        "max_abs_error_um": (1e6 * wrong).tolist(),
                    }
                )
    peaks = [(1e6 * np.abs(one.day[1]).max(axis=0)).tolist() for one in plants]
    return {"seed": SEED, "plants": PLANTS, "peak_um": peaks, "rows": rows}


def curve(rows: list[dict[str, Any]], how: str, key: str) -> dict[int, Array]:
    """Median over plants and sets of the larger axis, by number of sensors."""
    counts = sorted({row["count"] for row in rows if row["how"] == how})
    return {
        count: np.median(
            [row[key] for row in rows if row["how"] == how and row["count"] == count], axis=0
        )
        for count in counts
    }


def show(found: dict[str, Any]) -> None:
    """Print medians over the plants."""
    table = Table(title="Largest error of a day, median over plants (predicted band), µm, x/y")
    hows = list(dict.fromkeys(row["how"] for row in found["rows"]))
    table.add_column("sensors")
    for how in hows:
        table.add_column(how)
    curves = {
        how: (curve(found["rows"], how, "max_abs_error_um"), curve(found["rows"], how, "band_um"))
        for how in hows
    }
    for count in range(1, MOST + 1):
        cells = []
        for how in hows:
            wrong, band = (one.get(count) for one in curves[how])
            cells.append(
                ""
                if wrong is None or band is None
                else f"{wrong[0]:.2f}/{wrong[1]:.2f} ({band[0]:.1f}/{band[1]:.1f})"
            )
        table.add_row(str(count), *cells)
    Console(width=110).print(table)


def draw(found: dict[str, Any], path: Path) -> None:
    """Draw error and band against the number of sensors."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    for column, axis in enumerate("xy"):
        axes = figure.add_subplot(1, 2, column + 1)
        for how, style in (("placed", "o-"), ("PySensors", "s-"), ("at random", "^:")):
            wrong = curve(found["rows"], how, "max_abs_error_um")
            axes.plot(list(wrong), [one[column] for one in wrong.values()], style, label=how)
        band = curve(found["rows"], "placed", "band_um")
        axes.plot(list(band), [one[column] for one in band.values()], "k--", label="predicted band")
        axes.set_xlabel("sensors")
        axes.set_ylabel(f"largest error along {axis} in 8 h (µm)")
        axes.set_ylim(bottom=0.0)
    figure.axes[0].legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Run the study."""
    parser = options_of(__doc__, "sensor_count.json")
    parser.add_argument("--plot", type=Path, default=Path("sensor-count.png"))
    options = parser.parse_args()
    begun = time.perf_counter()
    with threadpool_limits(limits=1):
        found = study()
    write_json(options.out, found)
    show(found)
    draw(found, options.plot)
    print(f"{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
