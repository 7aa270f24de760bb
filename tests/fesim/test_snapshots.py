"""Field snapshots: the files that other programs open hold the fields that the march computed."""

from dataclasses import replace
from itertools import islice
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from bars import driven
from hypothesis import given
from hypothesis import strategies as st

from fesim.case.history import step_history
from fesim.case.schema import first_step_at
from fesim.march.stepping import march, staggered
from fesim.simulate import simulate
from fesim.snapshots import (
    joint_snapshot,
    points_of_bodies,
    snapshot_writer,
    structure_snapshot,
)
from thermojoint.artefacts.errors import InputError


@pytest.fixture(scope="module")
def steps(coarse_setup):
    machine = coarse_setup.machine
    return list(islice(march(machine, driven(machine, step_history(2.0 * 590.0)), staggered), 30))


def indexed(folder):
    """Time of every file that the index lists."""
    root = ElementTree.parse(folder / "snapshots.pvd").getroot()
    return {entry.get("file"): float(entry.get("timestep")) for entry in root.iter("DataSet")}


def test_a_snapshot_is_the_first_step_at_or_after_its_time(tmp_path, coarse_case, coarse_setup):
    requested = [0.0, 9.0, 10.0, 10.0, 11.9, 500.0]
    write = snapshot_writer(coarse_setup, tmp_path / "fields", requested)
    simulate(coarse_case, setup=coarse_setup, on_step=write)
    times = indexed(tmp_path / "fields")
    assert times == {
        f"{part}_{index:06d}.vtu": 2.0 * index
        for index in (1, 5, 6)
        for part in ("structure", "joints")
    }
    present = {path.name for path in (tmp_path / "fields").iterdir()}
    assert present == {"snapshots.pvd", *times}


@given(st.integers(1, 10**6), st.floats(1e-3, 100.0))
def test_a_time_of_a_step_is_that_step_however_it_was_rounded(index, length):
    assert first_step_at(index * length, length) == index
    assert first_step_at(np.nextafter(index * length, np.inf), length) == index
    assert first_step_at((index - 0.5) * length, length) == index


def test_the_index_grows_with_the_march(tmp_path, coarse_setup, steps):
    write = snapshot_writer(coarse_setup, tmp_path, [4.0, 8.0])
    for step in steps[:2]:
        write(step)
    assert set(indexed(tmp_path).values()) == {4.0}
    for step in steps[2:]:
        write(step)
    assert set(indexed(tmp_path).values()) == {4.0, 8.0}


def test_fields_read_back_are_those_of_the_march(tmp_path, coarse_setup, steps):
    write = snapshot_writer(coarse_setup, tmp_path, [60.0])
    for step in steps:
        write(step)
    structure = coarse_setup.structure
    grid = meshio.vtu.read(tmp_path / "structure_000030.vtu")
    # Table and screw share nodes: each has points of its own there.
    node, _ = points_of_bodies(structure)
    assert len(node) > structure.mesh.nvertices
    assert np.array_equal(grid.points.T, structure.mesh.p[:, node])
    assert np.array_equal(grid.point_data["temperature_K"], steps[-1].state.temperature[node])
    # The fields say the same of A and B as the condensed march does.
    nodes = [
        np.flatnonzero(np.isclose(grid.points, structure.probes[name].position).all(axis=1))[0]
        for name in ("A", "B")
    ]
    at_a, at_b = grid.point_data["displacement_m"][nodes]
    track = steps[-1].displacement
    assert at_a - at_b == pytest.approx(track, abs=1e-9 * np.abs(track).max())
    bodies = list(structure.bodies)
    for name, cells in structure.bodies.items():
        assert (grid.cell_data["body"][0][cells] == bodies.index(name)).all()


def test_supports_do_not_move_and_the_structure_grows(coarse_setup, steps):
    grid = structure_snapshot(coarse_setup, steps[-1])
    mesh, surfaces = coarse_setup.structure.mesh, coarse_setup.structure.surfaces
    displacement = grid.point_data["displacement_m"]
    assert not displacement[np.unique(mesh.facets[:, surfaces["column_base"]])].any()
    assert not displacement[np.unique(mesh.facets[:, surfaces["symmetry"]]), 2].any()
    assert np.abs(displacement).max() > 1e-6


def test_stresses_are_in_a_snapshot_of_each_body_for_itself(coarse_setup, steps):
    """The screw is 28 times stiffer than the table that it holds up: stress jumps between them."""
    grid = structure_snapshot(coarse_setup, steps[-1])
    principal, mises = grid.point_data["principal_stress_Pa"], grid.point_data["von_mises_Pa"]
    assert (np.diff(principal, axis=1) <= 0.0).all()
    apart = np.diff(principal[:, [0, 1, 2, 0]], axis=1)
    np.testing.assert_allclose(mises, np.sqrt(0.5 * (apart**2).sum(axis=1)), rtol=1e-9, atol=1.0)
    node, _ = points_of_bodies(coarse_setup.structure)
    count = coarse_setup.structure.mesh.nvertices
    assert (mises[count:] > 1.5 * mises[node[count:]]).all()


def test_the_joint_carries_its_contact_elements(tmp_path, coarse_setup, steps):
    step = steps[-1]
    meshio.vtu.write(tmp_path / "joints.vtu", joint_snapshot(coarse_setup, step))
    grid = meshio.vtu.read(tmp_path / "joints.vtu")
    contact = np.concatenate(grid.cell_data["contact"])
    corners = [grid.points[nodes] for block in grid.cells for nodes in block.data]
    areas = [
        0.5 * np.linalg.norm(np.cross(piece, np.roll(piece, -1, axis=0)).sum(axis=0))
        for piece in corners
    ]
    joint = coarse_setup.joints[0]
    assert np.bincount(contact - 1, areas) == pytest.approx(joint.area)
    for name, values in {
        "pressure_Pa": step.state.pressure,
        "conductance_W_m2K": step.conductance,
        "heat_flux_W_m2": step.heat_flow / joint.area,
        "opening_m": step.state.gap[0],
        "slip_m": step.state.slip.T,
    }.items():
        assert np.array_equal(np.concatenate(grid.cell_data[name]), values[contact - 1])
    # Each piece lies where its contact element is: between the neighbours' centres.
    height = np.array([piece[:, 1].mean() for piece in corners])
    assert (np.abs(height - joint.centre[contact - 1, 1]) < 0.4 / 18).all()


@pytest.mark.parametrize("time", [-1.0, np.nan, np.inf])
def test_a_time_before_the_march_is_refused(tmp_path, coarse_setup, time):
    with pytest.raises(InputError, match=r"output\.snapshots_s"):
        snapshot_writer(coarse_setup, tmp_path, [2.0, time])


def test_a_failed_snapshot_leaves_nothing(tmp_path, coarse_setup, steps):
    broken = replace(steps[0], conductance=steps[0].conductance[:-1])
    with pytest.raises(IndexError):
        snapshot_writer(coarse_setup, tmp_path, [2.0])(broken)
    assert not list(tmp_path.iterdir())


def test_pyvista_opens_the_index(tmp_path, coarse_setup, steps):
    pyvista = pytest.importorskip("pyvista")
    write = snapshot_writer(coarse_setup, tmp_path, [2.0, 60.0])
    for step in steps:
        write(step)
    reader = pyvista.get_reader(tmp_path / "snapshots.pvd")
    assert reader.time_values == [2.0, 60.0]
    reader.set_active_time_value(60.0)
    structure, joints = reader.read()
    node, _ = points_of_bodies(coarse_setup.structure)
    assert np.array_equal(structure["temperature_K"], steps[-1].state.temperature[node])
    assert structure.volume == pytest.approx(sum_of_volumes(coarse_setup))
    assert joints.area == pytest.approx(coarse_setup.joints[0].area.sum())
    assert joints["pressure_Pa"].min() == steps[-1].state.pressure.min()


def sum_of_volumes(setup):
    heat = setup.spaces.heat
    return float(heat.dx.sum())
