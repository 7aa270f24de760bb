"""Two slides on one guide, on an axis each."""

import pytest
from boxes import boxes

from fesim.axes.collision import Wanted, check_collisions
from fesim.axes.setup import asked_positions, course_of, volume_of
from fesim.case.schema import case_from_data
from fesim.setup.parts import make_parts
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import InputError
from thermojoint.verification.structures import IRON, material_section

SLIDES = ("near", "far")
JOINT = {
    "preload_MPa": 2.0,
    "along": 3,
    "across": 2,
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 1.961,
    "friction_coefficient": 0.0,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Slides of 60 mm, 240 mm apart."""
    folder = tmp_path_factory.mktemp("slides")
    structure = boxes(
        {name: (f"{name}.y0", "guide.y1") for name in SLIDES},
        guide=((0.0, -0.04, 0.0), (0.4, 0.0, 0.04), (20, 2, 2)),
        near=((0.0, 0.0, 0.0), (0.06, 0.04, 0.04), (3, 2, 2)),
        far=((0.3, 0.0, 0.0), (0.36, 0.04, 0.04), (3, 2, 2)),
    )
    write_structure(structure, folder / "slides.vtu")
    return folder


def check(folder, near, far, direction=1.0, volume=None, asked=None):
    """Check the slides along courses of (s, mm); that of `far` counts against its direction.

    `asked` are the positions of each slide at which results are wanted, by default 0 and 1 mm.
    """
    axes = {}
    for name, rows in {"near": near, "far": [(t, direction * x) for t, x in far]}.items():
        text = "".join(f"{time},{place}\n" for time, place in rows)
        (folder / f"{name}.csv").write_text("time_s,position_mm\n" + text)
        axes[name] = {
            "bodies": [name],
            "direction": [1.0 if name == "near" else direction, 0.0, 0.0],
            "stroke_mm": [-400.0, 400.0],
            "station_mm": 20.0,
            "file": f"{name}.csv",
            "asked_mm": (asked or {}).get(name, [0.0, 1.0]),
        }
    spring = {"stiffness_N_um": [50.0, 0.0, 50.0]}
    data = {
        "title": "two slides",
        "structure": {"kind": "mesh", "file": "slides.vtu"},
        "materials": {"iron": material_section(IRON)},
        "bodies": dict.fromkeys(("guide", *SLIDES), "iron"),
        "joints": {name: JOINT | {"axis": name} for name in SLIDES},
        "axes": axes,
        "supports": {
            "fixed": ["guide.y0"],
            "springs": {f"{name}.x1": spring for name in SLIDES},
        },
        "sources": {"heat": {"surface": "near.y1", "reference_power_W": 40.0, "reading": "total"}},
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": 20.0, "duration_min": 3.0},
        "displacement": {"point": "tool"},
        **({} if volume is None else {"volume": {"points_mm": [volume]}}),
        "probes": {"tool": {"position_mm": [30.0, 40.0, 0.0], "body": "near"}},
    }
    case = case_from_data(data, "slides", folder)
    courses = [course_of(axis, name) for name, axis in case.axes.items()]
    places = [asked_positions(axis) for axis in case.axes.values()]
    check_collisions(case, make_parts(case), Wanted(courses, places, volume_of(case).places))


def test_slides_that_follow_each_other_or_touch_share_a_guide(folder):
    check(folder, [(0, 0), (100, 240), (180, 0)], [(0, 0), (180, 0)])
    check(folder, [(0, 0), (180, 340)], [(0, 0), (180, 340)], asked={"far": [100.0, 340.0]})


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_slide_that_runs_into_another_one_is_refused(folder, direction):
    with pytest.raises(InputError, match=r"by 120 s, the pads of joints 'near' and 'far'"):
        check(folder, [(0, 0), (60, 200), (120, 200)], [(0, 0), (60, 0), (120, -100)], direction)


def test_slides_that_pass_through_each_other_between_two_times_are_refused(folder):
    with pytest.raises(InputError, match=r"by 180 s, .* correct the positions of axes"):
        check(folder, [(0, 0), (180, 300)], [(0, 0), (180, -300)])


def test_what_happens_after_the_march_is_not_refused(folder):
    check(folder, [(0, 0), (180, 0), (300, 300)], [(0, 0), (180, 0)])


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_results_are_refused_where_one_slide_would_stand_on_the_other(folder, direction):
    """The far slide leaves 240 mm free at first, and 120 at the end."""
    stands, leaves = [(0, 0), (180, 0)], [(0, 0), (180, -120)]

    def wanted(volume=None, **asked):
        placed = {name: [0.0, direction * -1.0 if name == "far" else 1.0] for name in SLIDES}
        check(folder, stands, leaves, direction, volume, placed | asked)

    wanted(near=[0.0, 120.0])
    with pytest.raises(InputError, match=r"axes\.near\.asked_mm: at 200 mm, the pads of joints"):
        wanted(near=[0.0, 200.0])
    with pytest.raises(InputError, match=r"axes\.far\.asked_mm: at -?120 mm, the pads"):
        check(
            folder,
            [(0, 0), (180, 130)],
            stands,
            direction,
            asked={"far": [direction * -120.0, 0.0]},
        )
    with pytest.raises(InputError, match=r"volume: at near = 200, far = -?120 mm, the pads"):
        wanted({"near": 200.0, "far": direction * -120.0})
