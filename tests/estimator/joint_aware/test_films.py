"""Films of single surfaces: what they take of the machine's convection, and how they are found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from observed import SENSORS

from calibrate.joint_aware.misfit import Run, physics_with
from calibrate.joint_aware.physics_fit import Search, fit_physics, refit
from fesim.case.schema import case_from_data
from meshes.inspection import area_of
from thermojoint.cli.results import further_run_line
from thermojoint.reduced.machine import along, reduce_machine
from thermojoint.reduced.parameters import with_factors
from thermojoint.reduced.physics import simulate_known

REAR, INSIDE = "film rear", "film interior, W/m2K"


def test_the_films_are_those_of_the_named_surfaces(machine, setup):
    """A field of 1 K loses film times area; the case has no film in the cavities."""

    def area(name):
        return area_of(setup.structure, setup.structure.surface(name))

    even = np.linalg.solve(machine.conduction + machine.convection, machine.ambient)
    areas = {film.surface: even @ film.convection @ even for film in machine.films}
    assert areas == pytest.approx(
        {
            "rear": 6.0 * area("rear"),
            "interior": area("interior"),
        }
    )
    assert [film.nominal for film in machine.films] == [1.0, 0.0]


def test_a_covered_surface_does_not_convect_in_the_reduced_machine_either(data, setup, machine):
    films = {"exterior": 6.0, "knee.a": 6.0, "knee.b": 6.0}
    covered = reduce_machine(
        case_from_data(data | {"convection_W_m2K": films}, "case", Path()), setup, SENSORS
    )
    size = np.abs(machine.convection).max()
    assert covered.convection == pytest.approx(machine.convection, abs=1e-9 * size)


@given(st.floats(0.2, 3.0), st.floats(0.01, 10.0), st.floats(0.0, 20.0))
def test_no_films_ever_heat(machine, common, rear, inside):
    other = with_factors(machine, {"film": common, REAR: rear, INSIDE: inside})
    losses = np.linalg.eigvalsh(other.convection)
    assert losses.min() >= -1e-9 * losses.max()


def cooled(machine, factors):
    """A run of 20 min of heat and 3 h of cooling."""
    length, count = 60.0, 200
    inputs = np.zeros((count, 2))
    inputs[:20, 0] = 2.0 * machine.power[0]
    answer = simulate_known(physics_with(machine, factors), inputs, length)
    return Run(inputs, length * np.arange(1.0, count + 1.0), *answer, length)


@pytest.mark.parametrize("inside", [0.0, 3.0])
def test_a_cool_down_tells_the_films(machine, inside):
    """Also one that the case does not have, from a search that begins where it is zero."""
    small = along(replace(machine, step=60.0), ["x", "y"])
    runs = [cooled(small, {REAR: 3.0, INSIDE: inside})]
    fit = fit_physics(small, runs, [REAR, INSIDE], Search(starts=0))
    found = dict(zip((REAR, INSIDE), fit.coordinates, strict=True))
    # The prior pulls a little towards the case.
    assert np.exp(found[REAR]) == pytest.approx(3.0, rel=0.1)
    assert found[INSIDE] == pytest.approx(inside, abs=0.4)
    assert np.all(np.sqrt(np.diag(fit.covariance)) < 0.5 * fit.spread)


def test_a_film_that_is_held_at_zero_does_not_hold_the_others(machine):
    """Where it would rise, too: of two runs of unlike machines one is left out."""
    small = along(replace(machine, step=60.0), ["x", "y"])
    runs = [cooled(small, {"film": film, INSIDE: 1.0}) for film in (1.5, 1.0)]
    fit = fit_physics(small, runs, ["film", INSIDE], Search(starts=0, evident=100.0))
    alone = fit_physics(small, runs[:1], ["film"], Search(starts=0))
    found = refit(small, runs, fit, 1)
    assert found.coordinates[1] == 0.0
    # A few evaluations take it most of its way.
    both, one = fit.coordinates[0], alone.coordinates[0]
    assert one > both + 0.1
    assert found.coordinates[0] > both + 0.6 * (one - both)


def test_a_film_far_beyond_the_prior_ends_at_its_bound(machine):
    """Three standard deviations of 0.4, which rounding takes beyond 3 on the way."""
    small = along(replace(machine, step=60.0), ["x", "y"])
    fit = fit_physics(small, [cooled(small, {"film": 8.0})], ["film"], Search(starts=0))
    # Its misfit is taken for errors of the model, so that the prior holds it back a little.
    assert fit.coordinates == pytest.approx([1.2], rel=0.01)


def test_the_run_that_tells_most_is_named_with_its_gain():
    days = {"none": (3.0, 4.0), "cool-down of 4 h": (0.3, 0.4), "step of 35 min": (2.9, 3.9)}
    runs = [
        {"run": name, "day_std_um": dict(zip("xy", day, strict=True))} for name, day in days.items()
    ]
    line = further_run_line(runs)
    assert "3.00 / 4.00 µm along x, y" in line
    assert "a cool-down of 4 h, 0.30 / 0.40 µm" in line
    assert "no further run" in further_run_line([runs[0], runs[2]])
