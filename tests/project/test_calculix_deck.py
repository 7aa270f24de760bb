"""The CalculiX deck says what the case says; where CalculiX is installed, both sides agree."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.against_calculix.compare import comparable
from benchmarks.against_calculix.deck import (
    Choices,
    conductance_table,
    pressure_table,
    write_deck,
)
from benchmarks.against_calculix.elements import connectivity, faces, node_basis
from benchmarks.against_calculix.laws import exponential
from benchmarks.against_calculix.problem import problem_of
from benchmarks.against_calculix.run import available, read_blocks, run_deck
from benchmarks.against_calculix.structures import bars, knee, machine
from benchmarks.against_calculix.studies import LINEAR, STEADY, TIGHT, compared
from meshes.pairing import outward_areas
from thermojoint.artefacts.errors import InputError


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    case = bars(tmp_path_factory.mktemp("bars"), 0.05)
    found = problem_of(case)
    return replace(found, law=comparable(found.law))


@pytest.fixture(scope="module")
def deck(problem):
    return write_deck(problem, Choices())


def section(text, keyword):
    """Data lines after the first line that starts with a keyword."""
    lines = iter(text.splitlines())
    next(line for line in lines if line.startswith(keyword))
    data = []
    for line in lines:
        if line.startswith("*"):
            break
        data.append([float(part) if _is_number(part) else part for part in line.split(", ")])
    return data


def _is_number(part):
    return re.fullmatch(r"[-+.\dE]+", part) is not None


def test_the_deck_asks_for_surface_to_surface_contact_with_conductance_and_friction(deck):
    for keyword in (
        "*CONTACT PAIR, INTERACTION=JOINT, TYPE=SURFACE TO SURFACE",
        "*GAP CONDUCTANCE",
        "*FRICTION",
        "*COUPLED TEMPERATURE-DISPLACEMENT",
    ):
        assert keyword in deck.text
    assert deck.text.count("*STEP") == deck.text.count("*END STEP") == 2


def test_every_node_and_cell_of_our_displacements_is_in_the_deck(problem, deck):
    basis = node_basis(problem.structure, "C3D20")
    assert len(section(deck.text, "*NODE")) == basis.N
    assert deck.text.count("TYPE=C3D20") == len(problem.structure.bodies)
    cells = connectivity(basis)
    assert cells.shape == (problem.structure.mesh.nelements, 20)
    assert all(len(set(cell)) == 20 for cell in cells)


def test_no_number_is_longer_than_the_twenty_characters_that_are_read(deck):
    data = [line for line in deck.text.splitlines() if not line.startswith("*")]
    assert max(len(part.strip()) for line in data for part in line.split(",")) <= 20


def test_elements_are_right_handed_and_their_faces_are_the_named_surfaces(problem):
    basis = node_basis(problem.structure, "C3D20")
    cells = connectivity(basis)
    nodes = basis.doflocs.T[cells]
    along = [nodes[:, k] - nodes[:, 0] for k in (1, 3, 4)]
    volume = np.einsum("ci,ci->c", np.cross(along[0], along[1]), along[2])
    assert volume.sum() == pytest.approx(0.25 * 0.06 * 0.04)
    assert (volume > 0.0).all()
    corners = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))
    for element, face in faces(problem.structure, basis, cells, "joint.a"):
        assert nodes[element - 1, list(corners[face - 1]), 0] == pytest.approx(0.1)


def test_contact_pressure_at_rest_is_the_preload_that_the_clamps_pull_with(problem, deck):
    ((hundredfold, start),) = section(deck.text, "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=EXP")
    at_rest = start * 100.0 ** (deck.shift / hundredfold)
    assert at_rest == pytest.approx(problem.law.preload, rel=1e-11)
    loads = section(deck.text, "*DLOAD")
    sides = sum(problem.structure.surfaces[s].size for s in ("joint.a", "joint.b"))
    assert len(loads) == sides
    assert {load[2] for load in loads} == {-problem.law.preload}


def test_side_b_is_moved_into_side_a_by_the_overclosure_at_rest(problem, deck):
    x = np.array([row[1] for row in section(deck.text, "*NODE")])
    basis = node_basis(problem.structure, "C3D20")
    moved = basis.doflocs[0] - x
    right = np.unique(basis.element_dofs[:, problem.structure.bodies["right"]])
    assert moved[right] == pytest.approx(deck.shift, abs=1e-13)
    assert np.delete(moved, right) == pytest.approx(0.0, abs=1e-13)


def test_the_conductance_table_is_equation_11_and_grows_with_pressure(problem, deck):
    table = np.array(section(deck.text, "*GAP CONDUCTANCE"))
    assert table[0] == pytest.approx([0.0, 0.0])
    assert (np.diff(table, axis=0) > 0.0).all()
    assert len(table) <= 20
    pressure = table[1:, 1]
    harmonic = 2.0 * 47.0 * 16.0 / (47.0 + 16.0)
    eq11 = 1.45 * 0.14 / 1.25e-6 * harmonic * (pressure / 1.961e9) ** 0.985
    assert table[1:, 0] == pytest.approx(eq11, rel=1e-12)
    between = np.sqrt(pressure[3:-1] * pressure[4:])
    read = np.interp(between, table[:, 1], table[:, 0])
    exact = np.array(conductance_table(problem, between))[:, 0]
    assert read == pytest.approx(exact, rel=3e-4)


def test_a_pressure_table_is_monotone_and_holds_the_preload(problem):
    law = problem.law
    shift = 5e-6
    pressure, depth = np.array(pressure_table(law, 15, shift)).T
    assert (np.diff(pressure) > 0.0).all()
    assert (np.diff(depth) > 0.0).all()
    assert pressure[depth == shift] == pytest.approx(law.preload)
    assert pressure[1:] == pytest.approx(law.normal.pressure(shift - depth[1:]))


def test_the_exponential_law_has_the_pressure_and_stiffness_of_the_law_it_stands_for(tmp_path):
    law = problem_of(bars(tmp_path, 0.05)).law
    rest = np.zeros(1)
    assert exponential(law).normal.pressure(rest) == pytest.approx(law.normal.pressure(rest))
    assert exponential(law).normal.slope(rest) == pytest.approx(law.normal.slope(rest))


def test_the_flux_over_the_source_is_its_power():
    problem = problem_of(machine())
    area = np.linalg.norm(
        outward_areas(problem.structure.mesh, problem.structure.surfaces["bearings"]), axis=1
    ).sum()
    # Heat input 3, 295 W per bearing, of which the half has one.
    assert problem.fluxes["bearings"] * area == pytest.approx(3.0 * 295.0)


def test_what_a_deck_cannot_say_is_refused(tmp_path, problem):
    ramp = {"kind": "ramp", "level": 1.0, "duration_min": 1.0}
    with pytest.raises(InputError, match="changes in time"):
        problem_of(machine(heat_input=ramp))
    surface_law = problem_of(bars(tmp_path, 0.05))
    with pytest.raises(InputError, match="table"):
        write_deck(surface_law, Choices())
    with pytest.raises(InputError, match="no element"):
        write_deck(problem, Choices(element="C3D10"))


def test_printed_results_are_read_with_the_last_time_counting():
    text = (
        " temperatures for set ALL and time  0.1E+01\n\n         1  0.100000E+01\n\n"
        " temperatures for set ALL and time  0.2E+01\n\n         1  0.200000E+01\n"
        "         2  0.300000-100\n"
    )
    assert read_blocks(text)["temperatures"].tolist() == [[1.0, 2.0], [2.0, 3e-101]]


@pytest.mark.skipif(available(), reason="CalculiX is installed")
def test_without_calculix_a_run_says_what_to_install(tmp_path, deck):
    with pytest.raises(InputError, match="install calculix-ccx"):
        run_deck(deck.text, tmp_path, "none", 1.0)


@pytest.mark.skipif(not available(), reason="needs ccx on the PATH (Debian: calculix-ccx)")
@pytest.mark.parametrize("changes", [LINEAR, {}], ids=["linear", "exponential"])
def test_calculix_agrees_on_two_bars(tmp_path, changes):
    case = bars(tmp_path, 0.05, **STEADY, **changes)
    choices = Choices(steady=True, tolerance=TIGHT)
    row, run = compared(case, choices, tmp_path, ("two bars", "test"))
    found = row.agreement
    assert found.pressure_scale > 1.5 * 4.41e6
    assert found.temperature < 5e-6
    assert found.displacement < 5e-6
    assert found.pressure < 5e-6
    assert np.ptp(run.contact_pressure) < 1e-5 * found.pressure_scale
    assert abs(found.normal_force) < 5e-6


@pytest.mark.skipif(not available(), reason="needs ccx on the PATH (Debian: calculix-ccx)")
def test_calculix_agrees_on_the_first_steps_of_two_rods(tmp_path):
    case = bars(tmp_path, 0.01, march__step_s=10.0, march__duration_min=1.0)
    row, _ = compared(case, Choices(tolerance=TIGHT), tmp_path, ("two rods", "test"))
    assert row.steps == 1 + 6
    assert row.agreement.temperature < 5e-3
    assert row.agreement.pressure < 5e-3


def test_of_a_guide_only_what_the_pads_cover_is_in_contact():
    _, meshed = knee(100.0, 50.0)
    problem = problem_of(meshed)
    problem = replace(problem, law=comparable(problem.law))
    text = write_deck(problem, Choices(steady=True, patience=9)).text
    pads, guide = (section(text, f"*SURFACE, NAME={side}") for side in ("SIDE_A", "SIDE_B"))
    assert len(guide) == len(pads) == len(problem.structure.surfaces["knee.b"])
    assert len(guide) < len(problem.structure.surfaces["knee.a"])
    # Both are pulled together, and CalculiX gives nothing up before its ninth iteration.
    assert len(section(text, "*DLOAD")) == len(pads) + len(guide)
    assert section(text, "*CONTROLS, PARAMETERS=TIME INCREMENTATION")[0][0] == 9.0


def test_of_pads_that_cover_parts_of_faces_there_is_no_deck():
    _, meshed = knee(100.0, 30.0)
    problem = problem_of(meshed)
    problem = replace(problem, law=comparable(problem.law))
    with pytest.raises(InputError, match="align the meshes"):
        write_deck(problem, Choices(steady=True))
