"""Machines whose supports give way though their case fixes them, and whose patches differ."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibrate.joint_aware.calibration import UNLIKE, loosened
from calibrate.joint_aware.misfit import Run, physics_with
from calibrate.joint_aware.physics_fit import Search, fit_physics
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from meshes.inspection import area_of
from thermojoint.reduced.loosened import loosening_of
from thermojoint.reduced.machine import along
from thermojoint.reduced.parameters import active, shown, with_factors
from thermojoint.reduced.physics import simulate_known

QUICK = Search(starts=0, rounds=2, evaluations=8, close=1e-3)
OPERATORS = ("compliance", "thermal_gap", "probe_compliance", "probe_thermal")
BASE, SCREW = "give column_base, um/kN", "give screw_foot, um/kN"


@pytest.fixture(scope="module")
def loosening(data, setup):
    found = loosening_of(case_from_data(data, "case", Path()), setup)
    assert found is not None
    return found


@pytest.mark.parametrize("gives", [(0.6, 0.6), pytest.param((0.1, 3.0), marks=pytest.mark.long)])
def test_supports_that_give_way_are_those_of_a_new_condensation(data, setup, loosening, gives):
    """Relative to what the give does."""
    names = loosening.supports.names
    springs = {
        name: {"stiffness_N_um": [1000.0 / give] * 3}
        for name, give in zip(names, gives, strict=True)
    }
    supports = {"symmetry": data["supports"]["symmetry"], "springs": springs}
    march = data["march"] | {"thermal": "full"}
    anew = set_up(case_from_data(data | {"supports": supports, "march": march}, "case", Path()))
    wanted = anew.machine.contact.elastic.turned(lambda rows: rows @ setup.modes.basis)
    found, fixed = loosening.supports.elastic(gives), loosening.supports.fixed
    for name in OPERATORS:
        size = np.abs(getattr(wanted, name) - getattr(fixed, name)).max()
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=3e-3 * size)


def test_supports_that_do_not_give_way_are_fixed(machine, loosening):
    stiff = with_factors(loosening.of(machine), {BASE: 1e-9, SCREW: 1e-9})
    for name in OPERATORS:
        fixed = getattr(machine.elastic, name)
        size = np.abs(fixed).max()
        assert getattr(stiff.elastic, name) == pytest.approx(fixed, abs=1e-6 * size)


def test_the_patches_are_the_surface_but_for_its_largest_part(machine, setup, loosening):
    even = np.linalg.solve(machine.conduction + machine.convection, machine.ambient)
    areas = {film.surface: even @ film.convection @ even for film in loosening.films}
    inside = areas.pop("column interior") + areas.pop("table interior")
    assert inside == pytest.approx(area_of(setup.structure, setup.structure.surface("interior")))
    whole = 6.0 * area_of(setup.structure, setup.structure.surface("exterior"))
    assert max(areas.values()) < whole - sum(areas.values()) < 0.5 * whole
    assert {name.split()[0] for name in areas} == {"column", "table"}


def test_nothing_is_loosened_where_more_than_heat_acts(data, setup):
    """Nor where no support is fixed."""
    gravity = {"gravity": {"acceleration_m_s2": [0.0, -9.81, 0.0]}}
    springs = {name: {"stiffness_N_um": [1e3] * 3} for name in data["supports"]["fixed"]}
    symmetry = data["supports"]["symmetry"]
    for given in ({"loads": gravity}, {"supports": {"symmetry": symmetry, "springs": springs}}):
        assert loosening_of(case_from_data(data | given, "case", Path()), setup) is None


def test_a_give_is_shown_with_its_relative_uncertainty():
    assert shown(BASE, 0.512, 0.2) == ("0.512", "20.0 %")


def runs_of(machine, factors):
    """Steps of heat and a cool-down of the machine with factors."""
    runs = []
    for level, count in ((0.5, 40), (2.0, 40), (2.0, 200)):
        inputs = np.zeros((count, 2))
        inputs[:40, 0] = level * machine.power[0]
        sensed, moved = simulate_known(physics_with(machine, factors), inputs, 60.0)
        runs.append(Run(inputs, 60.0 * np.arange(1.0, count + 1.0), sensed, moved, 60.0))
    return runs


def test_a_machine_on_feet_is_found(machine, loosening):
    small = along(replace(machine, step=60.0), ["x", "y"])
    true = {BASE: 1.5, SCREW: 0.8}
    runs = runs_of(loosening.of(small), true)
    fit = fit_physics(small, runs, search=QUICK)
    assert fit.doubt > 1.0
    found, again = loosened(small, runs, fit, QUICK, lambda: loosening)
    assert found.supports is not None
    # It explains all of the runs, but a machine unlike its case is not one of its family.
    assert again.doubt == UNLIKE < 0.8 * fit.doubt
    names = [parameter.name for parameter in again.parameters]
    assert names == [parameter.name for parameter in active(found)]
    for name, give in true.items():
        at = names.index(name)
        spread = np.sqrt(again.covariance[at, at])
        assert abs(np.log(again.parameters[at].factor(again.coordinates[at]) / give)) < spread


def test_a_machine_that_is_its_case_is_not_fitted_again(small):
    """One that is not keeps its first fit where feet do not explain it."""
    runs = runs_of(small, {"heat": 1.05})
    fit = fit_physics(small, runs, ["heat"], QUICK)
    assert fit.doubt == 1.0
    assert loosened(small, runs, fit, QUICK, pytest.fail) == (small, fit)
    doubted = replace(fit, doubt=1.01)
    assert loosened(small, runs, doubted, QUICK, lambda: None) == (small, doubted)
