"""Figures and pictures show the data they are given, and always exist."""

import io
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from estimator.fchs.judging import ESTIMATORS
from fesim.simulate import at_rest
from meshes.milling_machine import box_milling_machine
from thermojoint import console
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response
from thermojoint.paper import printing
from thermojoint.paper.report import Picture, ReportData, report_html
from thermojoint.paper.summary import convergence, pressure_share
from thermojoint.paper.verdict import error_table, paper_claim, verdict
from thermojoint.pictures import stills as pictures
from thermojoint.pictures.field_scenes import Fields, make_stage, pressure_panel
from thermojoint.pictures.figures import (
    DEVIATION,
    NONLINEAR,
    estimates_figure,
    heat_text,
    panels_figure,
    pressure_along,
    pressure_figure,
    response_figure,
    write_figure,
)
from thermojoint.pictures.scenes import boundary_faces, finished, mirror_of, probe_position
from thermojoint.pictures.structure_scene import structure_scene
from thermojoint.pictures.view import FIELDS, field_scene, named_surfaces, whole_structure

PNG = b"\x89PNG\r\n\x1a\n"
Y = (0.0, 1.0, 0.0)


def settling(constants, changes, end=2100.0):
    """A response whose contact pressures settle exponentially."""
    time = np.arange(0.0, end + 1.0, 2.0)
    moved = -np.expm1(-np.divide.outer(time, np.asarray(constants)))
    return make_response(
        {
            "heat_input": np.ones_like(time),
            "temperature": np.zeros((time.size, 1)),
            "displacement": np.zeros((time.size, 1)),
            "pressure": 4.41e6 + moved * np.asarray(changes),
        },
        {"time": time, "probe": ["a"], "axis": ["x"], "contact": np.arange(1, len(changes) + 1)},
    )


def polygon_areas(surface):
    corners = surface.points[surface.faces]
    around = np.roll(corners, -1, axis=1)
    middle = corners.mean(axis=1, keepdims=True)
    return np.linalg.norm(np.cross(corners - middle, around - middle).sum(axis=1), axis=1) / 2.0


def test_figure_7_shows_by_how_many_mpa_the_pressure_has_grown_over_minutes(coarse_response):
    axes = pressure_figure(coarse_response).axes[0]
    curves = [line for line in axes.lines if str(line.get_label()).startswith("element")]
    across = coarse_response["pressure"].to_numpy().reshape(len(coarse_response["time"]), 3, 9)
    pressure = across.mean(axis=1)
    assert len(curves) == 9
    for k, curve in enumerate(curves):
        assert np.allclose(curve.get_ydata(), (pressure[:, k] - pressure[0, k]) / 1e6)
        assert curve.get_xdata()[-1] == pytest.approx(1.0)
    assert "MPa" in axes.get_ylabel()
    assert "min" in axes.get_xlabel()


def test_the_preload_is_the_pressure_at_time_zero_alone():
    whole = settling(np.full(4, 600.0), np.full(4, 2e6))
    assert pressure_figure(whole).get_suptitle() == "heat input 1, preload 4.41 MPa"
    continued = whole.isel(time=slice(301, None))
    assert pressure_figure(continued).get_suptitle() == "heat input 1, at first up to 5.68 MPa"


def test_pressures_of_two_joints_are_not_averaged():
    """Their elements lie at the same places, one joint above the other."""
    response = settling(np.full(4, 600.0), np.array([1e6, 2e6, -3e6, -4e6]))
    places = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.1, 0.2, 0.0]]
    response["contact_position"] = ("contact", "direction"), np.array(places)
    response["contact_area"] = "contact", np.ones(4)
    response["contact_joint"] = "contact", ["saddle", "saddle", "slide", "slide"]
    assert np.array_equal(pressure_along(response), response["pressure"].to_numpy())
    assert "preload up to 4.41 MPa" in pressure_figure(response).get_suptitle()


def test_no_two_contact_elements_look_alike():
    figure = pressure_figure(settling(np.full(24, 60.0), np.linspace(-1e6, 1e6, 24)))
    curves = figure.axes[0].lines[:24]
    looks = {(str(curve._unscaled_dash_pattern), curve.get_color()) for curve in curves}
    assert len(looks) == 24


def test_axes_say_their_units_and_displacements_are_in_micrometres():
    times = np.array([0.0, 60.0])
    moved = {"x": {"actual": np.array([0.0, 1e-6])}}
    figure = panels_figure(times, moved, "heat input 2", *NONLINEAR)
    assert figure.axes[0].lines[0].get_ydata()[-1] == pytest.approx(1.0)
    assert "µm" in figure.axes[0].get_ylabel()
    curves = {"T1": {"simulated": times}, "T2": {"simulated": times}}
    figure = panels_figure(times, curves, "heat input 2", *DEVIATION)
    assert ["K" in axes.get_ylabel() for axes in figure.axes] == [True, True]


def test_an_unknown_picture_format_is_refused_and_leaves_nothing(tmp_path, coarse_response):
    with pytest.raises(InputError, match="picture format"):
        write_figure(response_figure(coarse_response), tmp_path / "curves.xyz")
    assert list(tmp_path.iterdir()) == []


@given(constant=st.floats(5.0, 200.0), change=st.floats(1e4, 1e7), sign=st.sampled_from((-1, 1)))
def test_a_pressure_that_settles_exponentially_has_the_exponential_share(constant, change, sign):
    found = pressure_share(settling([constant], [sign * change]), at_s=60.0)
    assert found.rows[0].share == pytest.approx(-np.expm1(-60.0 / constant), rel=1e-3)
    assert (found.rows[0].final_MPa > 0.0) is (sign > 0)


def test_the_least_share_counts_compressed_elements_only():
    found = pressure_share(settling([30.0, 60.0, 600.0], [1e6, 1e6, -1e6]))
    assert found.least_compressed == pytest.approx(-np.expm1(-1.0), rel=1e-3)


def test_an_element_whose_pressure_ends_near_where_it_began_has_no_share():
    found = pressure_share(settling([30.0, 30.0, 30.0], [1e6, 0.0, -0.05e6]))
    assert [row.share is None for row in found.rows] == [False, True, True]
    assert found.rows[2].final_MPa == pytest.approx(-0.05)


def test_a_response_too_short_for_a_share_is_refused():
    with pytest.raises(InputError, match="simulate it for longer"):
        pressure_share(settling([30.0], [1e6], end=60.0), at_s=60.0)


def test_convergence_takes_the_worst_step(coarse_response):
    found = convergence(coarse_response)
    assert found.steps == 30
    assert found.gap_residual == coarse_response["gap_residual"].max() <= 1e-11
    assert found.heat_balance <= 1e-8
    assert found.iterations == coarse_response["iterations"].sum()


def test_a_measured_response_has_no_solver_to_sum_up(coarse_response):
    measured = coarse_response[["heat_input", "temperature", "displacement"]]
    with pytest.raises(InputError, match="simulated"):
        convergence(measured)
    with pytest.raises(InputError, match="simulated"):
        pressure_figure(measured)


def test_boundary_faces_go_around_their_facets():
    mesh = box_milling_machine(element_size=0.1).mesh
    facets = mesh.boundary_facets()
    corners = mesh.p.T[boundary_faces(mesh, facets)]
    # Parallelograms: both diagonals meet in the middle only if the corners are in order.
    assert np.allclose(corners[:, 0] + corners[:, 2], corners[:, 1] + corners[:, 3])
    assert np.array_equal(np.sort(boundary_faces(mesh, facets)), np.sort(mesh.facets[:, facets].T))


def test_the_pressure_map_covers_the_joint_on_both_halves(coarse_setup, coarse_response):
    pressure = coarse_response["pressure"].to_numpy()[-1]
    mirror = mirror_of(coarse_setup.structure, {"symmetry": "z"})
    stage = make_stage(coarse_setup, (0.0, 1.0, 0.0), mirror)
    nothing = np.zeros(len(stage.nodes))
    fields = Fields(60.0, np.zeros(1), nothing, np.outer(nothing, np.ones(3)), pressure)
    (surface,) = (s for s in pressure_panel(stage, fields).surfaces if s.values is not None)
    area = coarse_response["contact_area"].to_numpy()
    assert polygon_areas(surface) == pytest.approx(np.tile(area, 2))
    assert surface.values == pytest.approx(np.tile(pressure / 1e6, 2))
    across = surface.points[surface.faces, 2]
    assert across[: area.size].max() < 0.25 < across[area.size :].min()


def test_every_surface_is_named_on_the_side_that_it_faces(coarse_setup):
    structure = coarse_setup.structure
    above, below = named_surfaces(structure).panels
    joints = {f"joint {name}" for name in structure.joints}
    sides = {side for both in structure.joints.values() for side in both}
    shown = [{marker.label for marker in panel.markers} for panel in (above, below)]
    assert shown[0] & shown[1] >= joints
    assert shown[0] | shown[1] == joints | (set(structure.surfaces) - sides)
    for panel in (above, below):
        for marker in panel.markers:
            if marker.label in structure.surfaces:
                facets = structure.surface(marker.label)
                at = structure.mesh.p[:, structure.mesh.facets[:, facets]].mean(axis=1).T
                assert np.abs(at - marker.position).max(axis=1).min() < 1e-12


def test_the_structure_is_drawn_whole_with_its_points(coarse_case, coarse_setup):
    scene = whole_structure(coarse_case, coarse_setup.structure)
    section, joint = scene.panels
    assert {"A", "B", "a", "b", "T1", "T2", "Q"} <= {marker.label for marker in section.markers}
    every = np.concatenate([s.points[s.faces].reshape(-1, 3) for s in section.surfaces])
    assert np.ptp(every, axis=0) == pytest.approx([1.45, 1.15, 0.25])
    # The second view is mirrored to the full width.
    every = np.concatenate([s.points[s.faces].reshape(-1, 3) for s in joint.surfaces])
    assert np.ptp(every, axis=0)[2] == pytest.approx(0.50)


def test_a_point_that_does_not_exist_cannot_be_marked():
    structure = box_milling_machine(element_size=0.1)
    with pytest.raises(InputError, match="probe named 'C'"):
        probe_position(structure, "C")


def test_fields_are_drawn_even_where_nothing_has_happened_yet(
    coarse_case, coarse_setup, tmp_path, monkeypatch
):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    rest = at_rest(coarse_setup.machine)
    files = {
        tmp_path / f"{show}.png": field_scene(show, coarse_case, coarse_setup, rest)
        for show in FIELDS
    }
    used = pictures.write_pictures(files, height=120)
    assert set(used.values()) == {"matplotlib"}
    assert all(path.read_bytes().startswith(PNG) for path in files)


def test_a_renderer_that_dies_leaves_the_picture_to_matplotlib(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    scene = structure_scene(box_milling_machine(element_size=0.1), ["bearings"], [], Y)
    path = tmp_path / "structure.png"
    assert pictures.write_pictures({path: scene}) == {path: "matplotlib"}
    assert [file.name for file in tmp_path.iterdir()] == ["structure.png"]
    assert path.read_bytes().startswith(PNG)


@pytest.mark.parametrize("name", ["structure.svg", "structure.jpg", "structure"])
def test_a_picture_under_a_name_that_is_no_png_is_refused(name, tmp_path):
    scene = structure_scene(box_milling_machine(element_size=0.1), ["bearings"], [], Y)
    with pytest.raises(InputError, match=r"PNG files; name it structure\.png"):
        pictures.write_pictures({tmp_path / "good.png": scene, tmp_path / name: scene})
    assert list(tmp_path.iterdir()) == []


def test_a_fallback_picture_says_that_it_is_one():
    scene = structure_scene(box_milling_machine(element_size=0.1), ["bearings"], [], Y)
    figure = pictures.sheet(*finished([scene]), None, height=120).figure
    assert pictures.FALLBACK_NOTE in [text.get_text() for text in figure.texts]


def test_the_report_escapes_what_it_shows_and_loads_nothing(tmp_path, coarse_response):
    write_figure(response_figure(coarse_response), tmp_path / "curves.svg")
    data = ReportData(
        title="<script>alert('title')</script>",
        facts=[("case & file", "<b>bold</b>")],
        share=pressure_share(settling([30.0, 30.0], [1e6, 0.0])),
        convergence={"<i>step</i>": convergence(coarse_response)},
        placement="a < b",
        pictures=[Picture(tmp_path / "curves.svg", 'a "quoted" <caption>')],
    )
    page = report_html(data)
    assert "<script" not in page
    assert "<b>bold" not in page
    assert "<i>step" not in page
    assert "a &lt; b" in page
    assert 'src="data:image/svg+xml;base64,' in page
    assert "http" not in page


def judged(case, axis, linear, fchs):
    return [
        {"case": case, "axis": axis, "estimator": name, "max_abs_error_um": error}
        for name, error in (("linear", linear), ("fchs", fchs))
    ]


def test_the_joint_aware_estimator_is_held_against_the_paper_as_fchs_is():
    rows = [
        {"case": "step-1.5", "axis": "x", "estimator": name, "max_abs_error_um": error}
        for name, error in (("linear", 0.9), ("fchs", 0.6), ("joint-aware", 0.05), ("ridge", 0.01))
    ]
    assert [paper_claim(row) for row in rows] == [None, 0.1, 0.1, None]
    text = verdict(rows)
    assert "FCHS estimator's largest error" in text
    assert "joint-aware estimator's largest error is within" in text
    assert "in 1 of 1 rows: step-1.5 x." in text


def test_errors_of_all_estimators_stand_beside_each_other():
    rows = judged("day", "x", 44.2, 36.4) + judged("step-1.5", "y", 3.08, 0.5688)
    table = error_table(rows)
    assert table.estimators == ("linear", "fchs")
    assert [(row.case, row.axis, row.errors, row.paper) for row in table.rows] == [
        ("day", "x", (44.2, 36.4), None),
        ("step-1.5", "y", (3.08, 0.5688), 0.1),
    ]
    terminal = Console(width=100, record=True, file=io.StringIO())
    printing.show_estimators(terminal, table)
    shown = terminal.export_text()
    for text in ("linear", "fchs", "44", "0.57", "–"):
        assert text in shown


@pytest.mark.parametrize(
    ("value", "text"), [(1232.4, "1232"), (10.0, "10"), (9.96, "10"), (0.0541, "0.054")]
)
def test_a_figure_has_two_digits_and_no_exponent(value, text):
    assert console.rounded(value) == text


def test_truth_stands_beside_our_estimates_and_the_best_of_the_others():
    truth = np.linspace(0.0, 1e-5, 5)[:, None] * [1.0, -2.0]
    errors = {name: np.full((5, 2), (k + 2) * 1e-7) for k, name in enumerate(ESTIMATORS)}
    errors |= {"none": -truth, "ridge": np.full((5, 2), 1e-8)}
    figure = estimates_figure(60.0 * np.arange(5.0), errors, ["x", "y"], "day")
    for panel, sign in zip(figure.axes[::2], (1.0, -2.0), strict=True):
        curves = {line.get_label(): line.get_ydata() for line in panel.get_lines()[:4]}
        assert list(curves) == ["actual", "fchs", "joint-aware", "ridge"]
        assert curves["actual"] == pytest.approx(sign * np.linspace(0.0, 10.0, 5))
        assert curves["ridge"] == pytest.approx(curves["actual"] + 0.01)
    assert all(panel.get_yscale() == "linear" for panel in figure.axes)


def test_the_verdict_says_what_was_reached_and_what_was_not():
    rows = judged("step-1.5", "x", 0.93, 0.64) + judged("step-3.0", "y", 6.05, 6.55)
    text = verdict(rows + judged("triangle", "x", 0.26, 0.08))
    assert "1 of 3 rows: triangle x." in text
    assert "step-1.5 x (0.64 against 0.1 µm), step-3.0 y (6.55 against 0.5 µm)" in text
    assert "in 2 of 3" in text
    assert text.endswith("smaller one in step-3.0 y (6.55 against 6.05 µm).")


def test_the_verdict_claims_nothing_for_the_paper_on_another_machine():
    text = verdict(judged("warm-up", "z", 1.0, 0.5))
    assert "paper" not in text
    assert "in 1 of 1" in text
    assert verdict([]) == ""


def test_the_verdict_compares_with_no_linear_model_where_there_is_none():
    """Where the calibration of the paper's models failed, it won in every row."""
    rows = [
        {"case": "day", "axis": "x", "estimator": name, "max_abs_error_um": 1.0}
        for name in ("none", "joint-aware")
    ]
    assert "linear" not in verdict(rows)


def test_every_figure_says_its_heat_input(coarse_response):
    assert heat_text(coarse_response) == "heat input 1 (590 W)"
    measured = coarse_response[["heat_input", "temperature", "displacement"]]
    assert heat_text(measured) == "heat input 1"
    ramp = measured.assign(heat_input=measured["time"] / 30.0)
    assert heat_text(ramp) == "heat input up to 2"
    weak = coarse_response.assign(source_power=0.001 * coarse_response["source_power"])
    assert heat_text(weak) == "heat input 1 (0.59 W)"
    for figure in (response_figure(coarse_response), pressure_figure(coarse_response)):
        assert "heat input 1 (590 W)" in figure.get_suptitle()


def test_heat_alone_has_no_panel_of_displacements(coarse_response, recwarn):
    heat = coarse_response.isel(axis=slice(0))
    labels = [panel.get_ylabel() for panel in response_figure(heat).axes]
    assert labels == ["heat input (reference = 1)", "temperature above the initial ambient (K)"]
    assert not recwarn.list
