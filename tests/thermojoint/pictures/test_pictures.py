"""What a picture shows can be seen: what is up, the colours, the labels, the frames of a film."""

import sys
from itertools import pairwise

import numpy as np
import pytest
from bars import DEPTH, WIDTH, two_bars
from hypothesis import example, given
from hypothesis import strategies as st

from fesim.case.thermal_sections import StepInput
from fesim.simulate import simulate
from meshes.milling_machine import box_milling_machine
from thermojoint.artefacts import extras
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import write_response
from thermojoint.pictures import film, renderer, view
from thermojoint.pictures.camera import Camera, facing, window_around
from thermojoint.pictures.colour_scale import colour_scale
from thermojoint.pictures.labels import place_labels
from thermojoint.pictures.renderer import creases, painted, pixel_size
from thermojoint.pictures.scenes import (
    Panel,
    Scene,
    Surface,
    bodies,
    finished,
    in_minutes,
    up_direction,
)
from thermojoint.pictures.show import Show, Up
from thermojoint.pictures.stills import sheet
from thermojoint.pictures.structure_scene import structure_scene
from thermojoint.pictures.view import FIELDS, draw, draw_film, film_scenes, whole_structure

finite = st.floats(-1.0, 1.0)
directions = st.tuples(finite, finite, finite).filter(lambda v: np.linalg.norm(v) > 0.1)
ENDS = ["left_end", "right_end"]


@pytest.fixture
def quick(monkeypatch):
    """Pictures are drawn without another process."""
    monkeypatch.setattr(renderer, "find_spec", lambda name: None)


@pytest.fixture(scope="module")
def scenes(coarse_case):
    """Four moments of the coarse machine's minute."""
    return film_scenes(FIELDS, coarse_case, lambda *_: None, 4)


def test_a_structure_stands_on_its_supports():
    bars = two_bars()
    # Clamped at its end, it lies, as in CAD.
    assert up_direction(bars, ["left_end"]) == (0.0, 0.0, 1.0)
    assert up_direction(bars, ["top"]) == (0.0, -1.0, 0.0)
    machine = box_milling_machine(element_size=0.1)
    assert up_direction(machine, ["column_base", "screw_foot"]) == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("supports", [[], ENDS])
def test_supports_that_do_not_say_what_is_up_leave_z(supports):
    assert up_direction(two_bars(), supports) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("source", "said"), [("top", "Q red"), ("bottom", "Q on the far side"), ("back", "Q red")]
)
def test_a_heat_source_is_called_red_where_it_can_be_seen(source, said):
    bars = two_bars()
    scene = structure_scene(bars, [source], (), (0.0, 1.0, 0.0))
    assert said in scene.panels[0].title


def test_what_is_up_can_be_said(coarse_case, coarse_setup):
    panel = whole_structure(coarse_case, coarse_setup.structure, up=Up.minus_x).panels[0]
    assert panel.camera.up == (-1.0, 0.0, 0.0)


@given(view=directions, up=directions)
@example(view=(1.0, 1.2e-07, 1.2e-07), up=(1.0, 0.0, 0.0))
def test_a_camera_is_a_right_handed_frame_that_looks_along_its_view(view, up):
    basis = Camera(view, up).basis
    assert basis @ basis.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(basis) == pytest.approx(1.0)
    assert basis[2] == pytest.approx(np.asarray(view) / np.linalg.norm(view), abs=1e-9)
    assert basis[1] @ np.asarray(up) >= -1e-9


def test_a_view_from_above_stays_above():
    view = facing(np.array([0.0, 0.0, 1.0]), (0.0, 1.0, 0.0), side=-0.5, height=0.3)
    assert Camera(view, (0.0, 1.0, 0.0)).basis[2][1] > 0.0


@given(st.lists(st.tuples(finite, finite), min_size=2, max_size=20))
def test_a_window_holds_its_points_and_is_filled_in_one_direction(points):
    points = np.array(points)
    left, right, bottom, top = window_around(points)
    assert (points >= [left, bottom]).all()
    assert (points <= [right, top]).all()
    filled = np.ptp(points, axis=0) / [right - left, top - bottom]
    assert filled.max() > 0.9 or np.ptp(points, axis=0).max() < 1e-6


@given(
    st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=1, max_size=30),
    st.floats(1e-6, 1e3),
)
@example([0.0, 502.0, -250594.0], 1.0)
def test_bands_rise_and_cover_the_field(values, factor):
    values = factor * np.array(values)
    scale = colour_scale("any", [values])
    levels = np.array(scale.levels)
    size = np.abs(values).max()
    assert (np.diff(levels) > 0.0).all()
    assert len(levels) < 40
    assert levels[0] <= values.min() + 2e-3 * size
    assert levels[-1] >= values.max() - 2e-3 * size


def test_a_field_that_is_hot_in_one_spot_uses_most_of_its_bands():
    distance = np.linspace(0.0, 1.0, 400)
    heat = 74.0 * np.exp(-12.0 * distance)
    scale = colour_scale("temperature (K)", [heat])
    used = np.unique(np.digitize(heat, scale.levels))
    assert np.median(heat) < 0.01 * heat.max()
    assert not scale.even
    assert "uneven" in scale.title
    assert len(used) >= 8


def test_a_field_that_fills_its_range_has_even_bands():
    scale = colour_scale("displacement (µm)", [np.linspace(0.0, 216.0, 100)])
    assert scale.even
    assert np.diff(scale.levels) == pytest.approx(np.diff(scale.levels)[0])


def test_bands_that_no_value_is_in_are_left_out():
    pressure = np.array([3.0, 4.0, 6.0, 7.0, 80.0])
    assert colour_scale("pressure (MPa)", [pressure]).levels == (2.0, 5.0, 10.0, 20.0, 50.0, 80.0)


def test_rounding_below_zero_is_not_a_band():
    heat = np.concatenate([[-1e-3], 74.0 * np.exp(-12.0 * np.linspace(0.0, 1.0, 400))])
    assert colour_scale("temperature (K)", [heat]).levels[0] == pytest.approx(0.0, abs=1e-12)


@given(st.lists(st.tuples(finite, finite), min_size=1, max_size=12), st.floats(0.05, 0.25))
def test_labels_cover_neither_each_other_nor_a_point(points, width):
    points = np.array(points)
    sizes = np.tile([width, 0.05], (len(points), 1))
    middles = place_labels(points, sizes, (-3.0, 3.0, -3.0, 3.0))
    for k, middle in enumerate(middles):
        assert (np.abs(middle - points) >= 0.5 * sizes[k] - 1e-12).any(axis=1).all()
        others = np.delete(middles, k, axis=0)
        assert (np.abs(middle - others) >= sizes[k] - 1e-12).any(axis=1).all()


def test_a_box_is_creased_at_its_twelve_edges():
    structure = two_bars(left=(1, 1, 1), right=(1, 1, 1))
    box = bodies(structure)["left"]
    assert len(creases(box.points, box.faces)) == 12
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert len(creases(flat, np.array([[0, 1, 2], [0, 2, 3]]))) == 4


def test_what_is_nearer_covers_what_is_farther():
    square = WIDTH * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    face = np.array([[0, 1, 2, 3]])
    near = Surface(square + np.array([0.0, 0.0, DEPTH]), face, "#ff0000")
    far = Surface(square, face, "#0000ff")
    for sign, seen in ((1.0, 0), (-1.0, 2)):
        camera = Camera((0.0, 0.0, sign), (0.0, 1.0, 0.0))
        panel = Panel("squares", (near, far), camera)
        (scene,) = finished([Scene((panel,))])
        middle = painted(scene.panels[0], 100)[50, -51]
        assert middle.argmax() == seen


def test_a_machine_fills_its_picture(coarse_case, coarse_setup):
    (scene,) = finished([whole_structure(coarse_case, coarse_setup.structure)])
    for panel in scene.panels:
        image = painted(panel, 200)
        assert image.shape == (200, pixel_size(panel.frame, 200)[0], 3)
        rows, columns = np.nonzero((image < 250).any(axis=2))
        filled = np.ptp(rows) / image.shape[0], np.ptp(columns) / image.shape[1]
        assert min(filled) > 0.85


def test_a_picture_says_when_it_is_and_what_heats_it(scenes):
    assert scenes[0].caption == "0 min, heat input 0 (0 W)"
    assert scenes[-1].caption == "1 min, heat input 1 (590 W)"


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(20.0, "0.333 min"), (59940.0, "999 min"), (59970.0, "1000 min"), (90060.0, "1501 min")],
)
def test_the_time_of_a_picture_has_all_its_minutes(seconds, said):
    assert in_minutes(seconds) == said


def test_a_film_has_one_camera_one_window_and_one_scale(scenes):
    convection_of = finished(scenes)
    assert len(convection_of) == 4
    for name in ("camera", "window", "scale"):
        looks = [[getattr(panel, name) for panel in scene.panels] for scene in convection_of]
        assert all(look == looks[0] for look in looks)
    assert [panel.shows for panel in convection_of[0].panels] == [
        "temperature rise (K)",
        "displacement (µm)",
        "contact pressure (MPa)",
    ]


def test_a_film_draws_the_displacement_up_to_the_time_of_its_fields(scenes):
    first, *_, last = finished(scenes)
    images = [np.zeros((2, 2, 3), dtype=np.uint8) for _ in first.panels]
    page = sheet(first, images, 60)
    for scene in (first, last):
        page.show(scene, images)
        curve, ends = scene.curve, [line.get_data() for line in page.curves]
        assert curve.title == "displacement of A relative to B"
        assert [minutes[-1] * 60.0 for minutes, _ in ends] == pytest.approx([curve.now] * 3)
        now = np.searchsorted(curve.times, curve.now - 1e-6)
        assert [moved[-1] for _, moved in ends] == pytest.approx(1e6 * curve.displacement[now])
    assert last.curve.now == last.curve.times[-1]


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_has_its_frames_and_they_differ(scenes, quick, tmp_path, suffix):
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / f"film{suffix}"
    told = []
    film.write_film(scenes[::2], out, lambda *done: told.append(done), 120)
    assert told == [(1, 2), (2, 2)]
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    with imageio.get_reader(out) as reader:
        frames = [np.asarray(frame)[:, :, :3] for frame in reader]
        meta = reader.get_meta_data()
    assert len(frames) == 2
    (size,) = {frame.shape for frame in frames}
    assert size[0] % 2 == size[1] % 2 == 0
    assert all((one != other).any() for one, other in pairwise(frames))
    if suffix == ".mp4":
        assert meta["duration"] == pytest.approx(2 / film.FRAMES_PER_SECOND, rel=0.05)
    else:
        assert meta["duration"] == pytest.approx(1000 / film.FRAMES_PER_SECOND, rel=0.05)


@pytest.mark.long
def test_pyvista_moves_one_plotter_through_a_film(scenes):
    pytest.importorskip("pyvista")
    images = list(renderer.rendered([finished(scenes[1:])], 60))
    if images[0] is None:
        pytest.skip("pyvista cannot render here")
    for k in range(3):
        first, second, last = (frame[k] for frame in images)
        assert (first != last).any()
        assert (second != last).any()


def test_a_film_that_fails_leaves_nothing(scenes, quick, tmp_path):
    pytest.importorskip("imageio_ffmpeg")

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film.write_film(scenes, tmp_path / "film.mp4", stop, 120)
    assert list(tmp_path.iterdir()) == []


def test_a_film_needs_its_suffix_and_its_extra(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"MP4 or GIF; name it film\.mp4"):
        film.check_film(tmp_path / "film.png")
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"thermojoint\[view\]"):
        film.check_film(tmp_path / "film.mp4")


def test_curves_have_no_direction_that_is_up(tmp_path):
    for show in (None, Show.curves, Show.pressures, Show.volume):
        with pytest.raises(InputError, match="--up z: --show"):
            draw(tmp_path / "r.nc", show, tmp_path / "r.png", lambda *_: None, Up.z)


def test_a_film_shows_fields_only(tmp_path):
    with pytest.raises(InputError, match="a film shows temperature, deformation, pressure"):
        view.draw_film(tmp_path / "case.toml", view.Show.curves, tmp_path / "f.mp4", print)


@pytest.mark.parametrize("drawn", [draw, draw_film])
def test_the_fields_of_a_response_that_continues_a_saved_state_are_not_drawn(
    coarse_case, coarse_setup, drawn, tmp_path
):
    # Its case says nothing of the state: from rest, a machine that cools would be cold throughout.
    begun = simulate(coarse_case, setup=coarse_setup)
    longer = coarse_case.march.model_copy(
        update={"duration_min": 2.0 * coarse_case.march.duration_min}
    )
    cooling = coarse_case.replace(heat_input=StepInput(kind="step", level=0.0), march=longer)
    response = simulate(cooling, setup=coarse_setup, start=begun.state).response
    write_response(response, tmp_path / "cooling.nc")
    out = tmp_path / ("film.gif" if drawn is draw_film else "end.png")
    with pytest.raises(InputError, match=r"cooling\.nc: continues a saved state, .*give the case"):
        drawn(tmp_path / "cooling.nc", Show.temperature, out, lambda *_: None)
    assert [path.name for path in tmp_path.iterdir()] == ["cooling.nc"]


def test_a_renderer_that_dies_within_a_film_leaves_the_rest_to_matplotlib(scenes, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    first, second = film.frames(scenes[:2], 60)
    assert (first != second).any()
