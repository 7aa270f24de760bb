"""Heat that no source of the case brings: where it enters, how it is followed, what it is worth."""

from dataclasses import replace

import numpy as np
import pytest
from exported import needs_gcc, selftest, written
from observed import MINUTE as STEP
from observed import PLACES, heated_through

from calibrate.joint_aware.assembling import make_observer, observer_from_rest, seen_heat
from calibrate.joint_aware.misfit import Run, physics_with
from calibrate.joint_aware.physics_fit import fit_physics
from estimator.export.program import Precision
from estimator.exporting import export_program
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Calibrated
from fesim.setup.faces import with_faces
from thermojoint.reduced.machine import diagonal_modes
from thermojoint.reduced.physics import simulate_known
from thermojoint.reduced.unknown_heat import with_unknown_heat

LASTS = 4.0 * 3600.0


@pytest.fixture(scope="module")
def fit(spread):
    """Of the machine itself: no parameter is changed, and nothing is left for the discrepancy."""
    inputs = np.zeros((60, 2))
    inputs[:35, 0] = 2.0 * spread.power[0]
    answer = simulate_known(physics_with(spread, {}), inputs, STEP)
    run = Run(inputs, STEP * np.arange(1.0, 61.0), *answer, STEP)
    return fit_physics(spread, [run], [])


@pytest.fixture(scope="module")
def known():
    return Calibrated(3600.0, 3.0, dict.fromkeys(PLACES, (-5.0, 60.0)))


def test_a_face_is_the_piece_of_surface_that_a_thermometer_is_on(spread_setup):
    """Both surfaces of a wall look the same way; they are two."""
    structure = spread_setup.structure
    closed = ["symmetry", "knee.a", "knee.b"]
    probes = {name: spread_setup.probes[name] for name in ("rear", "top", "s")}
    found, names = with_faces(structure, closed, probes)
    rear, top, inner = (found.surfaces[names[name]] for name in probes)
    assert set(rear) == set(structure.surfaces["rear"])
    corners = structure.mesh.p[:, structure.mesh.facets]
    assert corners[1, :, top] == pytest.approx(1.15)
    assert corners[0, :, inner] == pytest.approx(0.55)


def test_the_heat_of_a_face_is_one_more_mode(spread):
    """It relaxes, and warms the machine as a source whose heat relaxes would."""
    joined = spread.at_preload
    modes, added = with_unknown_heat(spread, joined, LASTS)
    count = added.shape[1]
    assert count == len(PLACES)
    kept = 1.0 / (1.0 + STEP * modes.rates)
    # A jump of 1 W of the first face: what a step adds, of unit variance in the long run.
    amplitudes = added[:, 0] / np.sqrt(1.0 - kept[-1] ** 2)
    heated = np.unique(spread.faces, axis=1)[:, :1]
    plain = diagonal_modes(replace(spread, sources=heated), joined)
    as_source, heat = np.zeros(plain.rates.size), 1.0
    for _ in range(100):
        as_source = (as_source + STEP * heat * plain.drive[:, 0]) / (1.0 + STEP * plain.rates)
        assert modes.sensors @ amplitudes == pytest.approx(plain.sensors @ as_source, abs=1e-12)
        assert modes.jump @ amplitudes == pytest.approx(plain.jump @ as_source, abs=1e-12)
        amplitudes, heat = kept * amplitudes, kept[-1] * heat


def warmed(machine):
    """Six hours at heat input 1 with up to 60 W through two faces, as samples and displacement."""
    count = 360
    hours = np.arange(count) / 60.0
    unknown = 60.0 * np.stack([np.sin(0.9 * hours) ** 2, (hours > 2.0) * 0.5], axis=1)
    plant = heated_through(machine, ("top", "table"))
    own = np.full((count, 1), machine.power[0])
    inputs = np.hstack([own, unknown, np.zeros((count, 1))])
    temperatures, moved = simulate_known(physics_with(plant, {}), inputs, STEP)
    times = STEP * np.arange(1.0, count + 1.0)
    return np.column_stack([times, temperatures, np.zeros(count)]), moved


def test_followed_it_costs_a_fraction_of_the_error(spread, fit, known):
    samples, moved = warmed(spread)
    error = {}
    for heat in (0.0, 20.0):
        model = observer_from_rest(spread, fit, known, Noise(unknown_heat=heat))
        off = np.abs(JointAware(model).displacements(samples) - moved)
        error[heat] = off.max(axis=0)
    assert error[0.0].max() > 3e-6
    assert error[20.0].max() < 0.25 * error[0.0].max()


def test_it_is_estimated_on_a_machine_unlike_its_case_whose_thermometers_tell_it(
    spread, fit, known
):
    largest, unlike = np.full(2, 100e-6), replace(fit, doubt=2.0)
    assert seen_heat(spread, fit, known, largest) == 0.0
    assert seen_heat(spread, unlike, known, largest) == pytest.approx(spread.power.mean() / 60.0)
    # Of a machine that hardly moves they tell it too roughly.
    assert seen_heat(spread, unlike, known, 0.01 * largest) == 0.0


@needs_gcc
@pytest.mark.long
def test_its_program_follows_it_too(spread, fit, known, tmp_path):
    model = make_observer(spread, fit, known, Noise(unknown_heat=20.0))
    samples, _ = warmed(spread)
    found = export_program(JointAware(model), Precision.DOUBLE, "m", samples.tolist())
    figures = selftest(written(found, tmp_path), "m", "-O1")
    assert figures["status words that differ"] == 0
