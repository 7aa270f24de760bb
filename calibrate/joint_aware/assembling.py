"""Observer of a fitted machine: modes at the preload, filter, initial state, band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibrate.joint_aware.past import COLUMNS, answer, random_pasts, start_factor, states_after
from calibrate.joint_aware.physics_fit import Fit
from calibrate.joint_aware.sticking import combinations, tangents_at
from estimator.joint_aware.filter_design import NOISE, Noise, design_filter, linear_system
from estimator.joint_aware.observer_model import Band, Calibrated, ObserverModel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.reduced.machine import Modes, ReducedMachine, diagonal_modes
from thermojoint.reduced.parameters import factors_of, with_factors
from thermojoint.reduced.unknown_heat import with_unknown_heat

#: Unknown heat of a face, relative to the mean of the sources, and the standard deviation of the
#: displacement, relative to the largest, up to which thermometers determine it: on six structural
#: plants 0.02 to 0.3 % with ten thermometers on all bodies, 2 to 4 % with four on one body.
UNKNOWN, TOLD = 1.0 / 60.0, 1.0 / 150.0
#: Model errors persist over a hundred samples: as white noise they are this many times larger.
LASTS = 10.0


def make_observer(
    machine: ReducedMachine, fit: Fit, calibrated: Calibrated, noise: Noise = NOISE
) -> ObserverModel:
    """Return the observer of a fitted machine; see `observer_from_rest`."""
    model = observer_from_rest(machine, fit, calibrated, noise)
    pasts, steady = random_pasts(calibrated.heat, machine.power.size), model.filter
    rates = fit.discrepancy.rates
    states = states_after(model.modes, rates, machine.power, steady.walk, pasts)
    return replace(model, warm=start_factor(states, steady.scale))


def observer_from_rest(
    machine: ReducedMachine, fit: Fit, calibrated: Calibrated, noise: Noise = NOISE
) -> ObserverModel:
    """Return the observer of a fitted machine without the covariance of a warm start.

    Its band does not include the uncertainty of the calibration: `open_band`.

    Parameters
    ----------
    machine : ReducedMachine
        As described by its case.
    fit : Fit
        Its parameters, discrepancy and sensors.
    calibrated : Calibrated
        Range of the calibration.
    noise : Noise
        Assumed noise.

    Raises
    ------
    ConvergenceError
        The sensors do not determine the heat.
    """
    # A calibration without noise gives no evidence about that of later readings.
    own = np.maximum(noise.sensor, fit.noise)
    # ... and model errors that last for minutes count as noise that is larger by this factor.
    errs = np.sqrt(np.maximum(fit.residual_temperature**2 - fit.noise**2, 0.0))
    whole = np.hypot(own, LASTS * errs)
    noise = replace(noise, sensor=whole, lasting=noise.lasting * whole / own)
    fitted = with_factors(machine, factors_of(fit.parameters, fit.coordinates))
    joined = fitted.at_preload
    modes, unknown = _modes(fitted, joined, noise)
    system = linear_system(modes, fit.discrepancy, machine.power, machine.step)
    held = machine.held
    walk = np.concatenate(
        [noise.heat_walk * machine.power, noise.held_walk * held.varies, [noise.ambient_walk]]
    )
    design, after = design_filter(system, modes, walk, machine.step, noise, unknown)
    # Amplitudes are in one unit: the norm of a field is that of its heat content.
    hour = np.linalg.norm(modes.drive[:, 0] * machine.power[0] * answer(modes.rates, 3600.0))
    relaxations = system.decay.size - modes.rates.size
    scale = np.concatenate(
        [
            np.full(modes.rates.size, hour),
            np.ones(relaxations),
            machine.power,
            np.ones(len(held.names) + 1),
        ]
    )
    steady = replace(design, scale=scale)
    others = [fit.discrepancy.displacement, np.zeros((len(machine.axes), walk.size))]
    # At every aligned position of an axis; of several axes at ends and middles of their strokes.
    places = combinations([] if modes.way is None else modes.way.stations.positions)
    tangents = tangents_at(modes, fitted.laws, places)
    everywhere = [np.hstack([own, *others]) for own in tangents]
    moved = everywhere[len(everywhere) // 2]
    nothing = np.zeros((len(machine.axes), fit.discrepancy.rates.size))
    spread = np.sqrt(np.diag(fit.covariance))
    return ObserverModel(
        modes=modes,
        held=joined,
        joints=fitted.joints,
        discrepancy=fit.discrepancy,
        filter=steady,
        band=Band(
            tangent=moved,
            steady=np.max(
                [np.einsum("an,nm,am->a", own, after, own) for own in everywhere], axis=0
            ).clip(0.0),
            constant=fit.residual_displacement**2,
            history=np.zeros(len(machine.axes)),
            drive=np.zeros(len(machine.axes)),
            open=np.zeros((len(machine.axes), 1, 2 * fit.discrepancy.displacement.shape[1])),
            square=nothing,
            surprise=np.zeros((len(machine.axes), len(system.rows))),
            seen=np.zeros(0),
            told=np.zeros((len(machine.axes), 0)),
            allowed=np.ones(()),
        ),
        warm=np.zeros((scale.size, COLUMNS)),
        surfaces=held.names,
        first=held.first,
        power=machine.power,
        step=machine.step,
        offset=fit.offset,
        loads=machine.load_names,
        sensors=machine.sensor_names,
        places={name: at for name, at in machine.places.items() if name in machine.sensor_names},
        displacement_of=machine.displacement_of,
        axes=machine.axes,
        sources=machine.source_names,
        calibrated=calibrated,
        moving_axes=() if machine.guide is None else machine.guide.axes,
        factors={
            parameter.name: (parameter.factor(float(value)), float(deviation))
            for parameter, value, deviation in zip(
                fit.parameters, fit.coordinates, spread, strict=True
            )
        },
    )


def _modes(machine: ReducedMachine, joined: Array, noise: Noise) -> tuple[Modes, Array]:
    """Modes of a machine, and their change by unknown heat in a step (`with_unknown_heat`)."""
    if noise.unknown_heat == 0.0:
        modes = diagonal_modes(machine, joined)
        return modes, np.zeros((modes.rates.size, 0))
    modes, added = with_unknown_heat(machine, joined, noise.unknown_lasts)
    return modes, noise.unknown_heat * added


def seen_heat(machine: ReducedMachine, fit: Fit, calibrated: Calibrated, largest: Array) -> float:
    """Return the unknown heat of each face that an observer is to estimate, W; zero for none.

    A machine of the family of its case needs none. For any other it is estimated if thermometers
    would determine heat in any of its bodies well enough for the displacement. If not, model errors
    near a source would be mistaken for heat far away.

    Parameters
    ----------
    machine, fit, calibrated
        As in `observer_from_rest`.
    largest : ndarray, shape (axes,)
        Largest displacement in the calibration runs, m.
    """
    heat = UNKNOWN * float(machine.power.mean())
    if fit.doubt <= 1.0:
        return 0.0
    try:
        anywhere = replace(machine, faces=machine.bodies)
        found = observer_from_rest(anywhere, fit, calibrated, Noise(unknown_heat=heat))
    except ConvergenceError:
        return 0.0
    told = np.sqrt(found.band.steady) <= TOLD * largest
    return heat if told.all() else 0.0
