"""A structure without joints: plain linear thermoelasticity by the same march."""

from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr
from skfem import MeshHex

from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.pictures import renderer, view

LENGTH, SIDE, RISE, EXPANSION = 0.2, 0.04, 20.0, 1.1e-5


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A bar on rollers."""
    ends = (LENGTH, 8), (SIDE, 2), (SIDE, 2)
    mesh = MeshHex.init_tensor(*(np.linspace(0.0, end, n + 1) for end, n in ends))
    outside = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, outside]].mean(axis=1)
    faces = {"foot": x, "bottom": y, "back": z}
    structure = Structure(
        mesh=mesh,
        bodies={"bar": np.arange(mesh.nelements)},
        surfaces={name: outside[away < 1e-9] for name, away in faces.items()},
        joints={},
    )
    path = tmp_path_factory.mktemp("bar") / "bar.vtu"
    write_structure(structure, path)
    return path


def case_text(path, thermal):
    return f"""
title = "A bar"
structure = {{ kind = "mesh", file = "{path}" }}
bodies = {{ bar = "iron" }}
supports = {{ symmetry = {{ foot = "x", bottom = "y", back = "z" }} }}
march = {{ step_s = 60.0, duration_min = 600.0, thermal = "{thermal}" }}
displacement = {{ point = "end" }}
held_temperatures = {{ foot = {{ rise_K = {RISE} }} }}
probes = {{ end = {{ position_mm = [200.0, 0.0, 0.0] }} }}
[materials.iron]
conductivity_W_mK = 50.0
density_kg_m3 = 7200.0
heat_capacity_J_kgK = 500.0
youngs_modulus_GPa = 110.0
poisson_ratio = 0.25
expansion_1_K = {EXPANSION}
"""


@pytest.mark.parametrize("thermal", ["full", "reduced"])
def test_a_bar_without_joints_grows_as_its_temperature_says(bar, thermal, tmp_path):
    """Warmed through from its foot, it is free of stress and longer by alpha T L."""
    (tmp_path / "case.toml").write_text(case_text(bar, thermal))
    out = tmp_path / "bar.nc"
    app(["simulate", str(tmp_path / "case.toml"), "--out", str(out)], standalone_mode=False)
    with xr.open_dataset(out) as response:
        assert response.sizes["contact"] == 0
        track = response["displacement"].sel(axis="x").to_numpy()
        temperature = response["temperature"].to_numpy()[:, 0]
        balance = response["heat_balance"].to_numpy()
    assert temperature[-1] == pytest.approx(RISE, rel=1e-6)
    assert track[-1] == pytest.approx(EXPANSION * RISE * LENGTH, rel=1e-6)
    # The tip is the last to be warm: on the way the bar is longer than its tip is hot.
    assert (track[1:-300] > EXPANSION * temperature[1:-300] * LENGTH).all()
    assert np.abs(balance).max() < 1e-8


@pytest.fixture(scope="module")
def simulated(bar, tmp_path_factory):
    """A folder with the case, its response and its snapshots."""
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "case.toml").write_text(case_text(bar, "full").replace("600.0", "2.0", 1))
    command = ["simulate", str(folder / "case.toml"), "--out", str(folder / "bar.nc")]
    app([*command, "--snapshots", str(folder / "fields")], standalone_mode=False)
    return folder


def test_a_snapshot_without_joints_is_the_structure_alone(simulated):
    fields = simulated / "fields"
    index = ElementTree.parse(fields / "snapshots.pvd").getroot()
    assert [entry.get("file") for entry in index.iter("DataSet")] == ["structure_000002.vtu"]
    written = {"contents.json", "snapshots.pvd", "structure_000002.vtu"}
    assert {path.name for path in fields.iterdir()} == written


@pytest.mark.parametrize("show", ["structure", "temperature", "deformation"])
@pytest.mark.parametrize("source", ["case.toml", "bar.nc"])
def test_what_has_no_joint_is_drawn(simulated, source, show, tmp_path, monkeypatch):
    monkeypatch.setattr(renderer, "find_spec", lambda name: None)
    out = tmp_path / "bar.png"
    command = ["view", str(simulated / source), "--show", show, "--out", str(out)]
    app(command, standalone_mode=False)
    assert out.stat().st_size > 0


@pytest.mark.parametrize("show", ["pressure", "pressures"])
@pytest.mark.parametrize("source", ["case.toml", "bar.nc"])
def test_without_joints_there_is_no_pressure_to_show(
    simulated, source, show, tmp_path, monkeypatch
):
    monkeypatch.setattr(view, "run_to_end", None)  # refused before any simulation
    out = tmp_path / "pressure.png"
    command = ["view", str(simulated / source), "--show", show, "--out", str(out)]
    with pytest.raises(InputError, match="no joints, so no contact pressure; use --show"):
        app(command, standalone_mode=False)
    assert not out.exists()
