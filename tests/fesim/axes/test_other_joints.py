"""Joints that ride on no axis march beside those that do, with friction and all."""

import numpy as np
import pytest
from skfem import MeshHex

from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.verification.structures import IRON, box_surfaces, facing_sides, material_section

JOINT = {
    "preload_MPa": 2.0,
    "across": 2,
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 1.961,
}


def stack(shown):
    """A slide that begins at x = `shown`, m, on a guide on a floor."""
    x, z = np.linspace(0.0, 0.4, 21), np.linspace(0.0, 0.04, 3)
    grids = [(x, (-0.08, -0.04)), (x, (-0.04, 0.0)), (shown + np.linspace(0, 0.08, 5), (0.0, 0.04))]
    mesh, bodies = put_side_by_side(
        [MeshHex.init_tensor(along, np.linspace(*ends, 3), z) for along, ends in grids]
    )
    facets = mesh.boundary_facets()
    along, up, _ = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    low, high = facing_sides(mesh, 1, -0.04), facing_sides(mesh, 1, 0.0)
    names = {
        "floor_top": low["joint.a"],
        "guide_foot": low["joint.b"],
        "way": high["joint.a"],
        "pads": high["joint.b"],
        "tail": facets[(up > 0.0) & (np.abs(along - shown) < 1e-9)],
    }
    bodies = dict(zip(("floor", "guide", "slide"), bodies, strict=True))
    return Structure(mesh, bodies, box_surfaces(mesh) | names)


def march(folder, shown, axis):
    write_structure(stack(shown), folder / "stack.vtu")
    data = {
        "title": "slide, guide, floor",
        "structure": {"kind": "mesh", "file": "stack.vtu"},
        "materials": {"iron": material_section(IRON)},
        "bodies": {"floor": "iron", "guide": "iron", "slide": "iron"},
        "joints": {
            "low": JOINT
            | {"side_a": "floor_top", "side_b": "guide_foot", "along": 6}
            | {"friction_coefficient": 0.2},
            "high": JOINT
            | {"side_a": "pads", "side_b": "way", "along": 4, "friction_coefficient": 0.0}
            | ({"axis": "x"} if axis else {}),
        },
        "axes": {"x": axis} if axis else {},
        "supports": {
            "fixed": ["y0"],
            "symmetry": {"z0": "z"},
            "springs": {"tail": {"stiffness_N_um": [50.0, 0.0, 0.0]}},
        },
        "sources": {"heat": {"surface": "y1", "reference_power_W": 40.0, "reading": "total"}},
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": 20.0, "duration_min": 3.0},
        "displacement": {"point": "tool", "relative_to": "below"},
        "probes": {
            "tool": {"position_mm": [1e3 * shown + 80.0, 40.0, 0.0], "body": "slide"},
            "below": {"position_mm": [200.0, -20.0, 0.0], "body": "guide"},
        },
    }
    return simulate(case_from_data(data, "stack", folder), accuracy=False).response


def test_a_joint_with_friction_beside_the_guide_is_that_of_the_machine_meshed_there(tmp_path):
    axis = {
        "bodies": ["slide"],
        "direction": [1.0, 0.0, 0.0],
        "stroke_mm": [0.0, 320.0],
        "mesh_position_mm": 120.0,
        "station_mm": 20.0,
        "position_mm": 200.0,
    }
    on_axis, meshed = march(tmp_path, 0.12, axis), march(tmp_path, 0.2, None)
    for name in ("displacement", "temperature", "pressure", "heat_flow"):
        size = float(np.abs(meshed[name]).max())
        assert np.allclose(on_axis[name], meshed[name], rtol=0.0, atol=1e-6 * size), name
    low = meshed["contact_joint"] == "low"
    slip = float(np.abs(meshed["slip"].where(low)).max())
    assert slip > 1e-7
    apart = float(np.abs((on_axis["slip"] - meshed["slip"]).where(low)).max())
    assert apart == pytest.approx(0.0, abs=1e-5 * slip)
    assert float(np.abs(on_axis["heat_balance"]).max()) < 1e-8
