"""A march that was saved and continued is the march that was never interrupted, bit for bit."""

import json
from dataclasses import fields

import numpy as np
import pytest

from fesim.case.schema import case_from_data
from fesim.march.machine import State
from fesim.march.state_file import fingerprint, load_state, save_state
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import InputError

TIMED = ("temperature", "displacement", "pressure", "conductance", "heat_flow", "opening", "slip")
EVIDENCE = ("gap_residual", "iterations", "cuts", "heat_balance", "heat_input")


def case_of(data, folder, **sections):
    return case_from_data(
        data | {name: data.get(name, {}) | part for name, part in sections.items()}, "case", folder
    )


@pytest.fixture(scope="module")
def saved(tmp_path_factory, coarse_case, coarse_setup):
    """The state after one minute, in a file."""
    path = tmp_path_factory.mktemp("state") / "state.npz"
    state = simulate(coarse_case, setup=coarse_setup).state
    save_state(state, coarse_case, path)
    return path, state


@pytest.mark.parametrize("coupling", ["staggered", "iterated"])
def test_a_continued_march_is_the_uninterrupted_one(tmp_path, coarse_data, coarse_setup, coupling):
    hot = {"heat_input": {"kind": "triangle", "peak": 60.0, "duration_min": 2.0}}
    half, whole = (
        case_of(coarse_data | hot, tmp_path, march={"duration_min": minutes, "coupling": coupling})
        for minutes in (1.0, 2.0)
    )
    path = tmp_path / "state.npz"
    first = simulate(half, setup=coarse_setup)
    save_state(first.state, half, path)
    second = simulate(whole, setup=coarse_setup, start=load_state(path, whole))
    uninterrupted = simulate(whole, setup=coarse_setup)
    assert np.abs(first.state.slip).max() > 0.0, "the march must have history to carry over"
    for name in ("time", *TIMED, *EVIDENCE):
        rows = np.concatenate([first.response[name], second.response[name]])
        assert np.array_equal(rows, uninterrupted.response[name]), name
    for field in fields(State):
        ours, theirs = getattr(second.state, field.name), getattr(uninterrupted.state, field.name)
        assert np.array_equal(ours, theirs), field.name


def test_a_state_survives_the_file_bit_for_bit(saved, coarse_case):
    path, state = saved
    back = load_state(path, coarse_case)
    for field in fields(State):
        ours, theirs = getattr(back, field.name), getattr(state, field.name)
        assert np.array_equal(ours, theirs)
        assert type(ours) is type(theirs)


def test_what_is_only_recorded_may_differ(saved, coarse_data, tmp_path):
    other = coarse_data | {
        "title": "another run",
        "heat_input": {"kind": "step", "level": 3.0},
        "output": {"snapshots_s": [10.0]},
        "displacement": {"point": "B", "relative_to": None},
        "probes": {"a": coarse_data["probes"]["a"]},
        "bodies": dict(reversed(coarse_data["bodies"].items())),
        "sources": {
            "bearings": coarse_data["sources"]["bearings"]
            | {"heat_input": {"kind": "step", "level": 2.0}}
        },
    }
    case = case_of(other, tmp_path, march={"duration_min": 90.0})
    assert np.array_equal(load_state(saved[0], case).temperature, saved[1].temperature)


@pytest.mark.parametrize(
    "sections",
    [
        {"structure": {"element_size_mm": 90.0}},
        {"structure": {"dimensions_mm": {"wall": 49.0}}},
        {"march": {"step_s": 1.0}},
        {"march": {"coupling": "iterated"}},
        {"sources": {"bearings": {"surface": "bearings", "reference_power_W": 147.5}}},
        {"convection_W_m2K": {"exterior": 7.0}},
        {"supports": {"fixed": ["column_base"]}},
    ],
)
def test_another_machine_refuses_the_state(saved, coarse_data, tmp_path, sections):
    with pytest.raises(InputError, match="state of another structure"):
        load_state(saved[0], case_of(coarse_data, tmp_path, **sections))


@pytest.mark.parametrize("key", ["friction_coefficient", "preload_MPa", "roughness_um"])
def test_another_joint_refuses_the_state(saved, coarse_data, tmp_path, key):
    knee = coarse_data["joints"]["knee"]
    case = case_of(coarse_data, tmp_path, joints={"knee": knee | {key: 0.9 * knee[key]}})
    with pytest.raises(InputError, match="state of another structure"):
        load_state(saved[0], case)


def test_the_order_of_joints_is_part_of_the_machine(coarse_data, tmp_path):
    knee = coarse_data["joints"]["knee"]
    one = case_of(coarse_data | {"joints": {"p": knee, "q": knee}}, tmp_path)
    other = case_of(coarse_data | {"joints": {"q": knee, "p": knee}}, tmp_path)
    assert fingerprint(one) != fingerprint(other)


def test_a_state_of_heat_alone_is_not_one_of_a_machine_that_deforms(coarse_data, tmp_path):
    """Its joints have not moved, and friction would remember another way."""
    knee = coarse_data["joints"]["knee"] | {"conductance": {"law": "fixed", "value_W_m2K": 1e3}}
    data = coarse_data | {"joints": {"knee": knee}}
    alone = {name: part for name, part in data.items() if name != "displacement"}
    assert fingerprint(case_of(alone, tmp_path)) != fingerprint(case_of(data, tmp_path))


def test_a_mesh_file_counts_by_its_content(coarse_data, coarse_setup, tmp_path):
    for name in ("one.vtu", "moved/same.vtu"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_structure(coarse_setup.structure, tmp_path / name)
    one, same = (
        case_of(coarse_data | {"structure": {"kind": "mesh", "file": name}}, tmp_path)
        for name in ("one.vtu", "moved/same.vtu")
    )
    before = fingerprint(one)
    assert before == fingerprint(same)
    with (tmp_path / "one.vtu").open("a") as file:
        file.write("\n")
    assert fingerprint(one) != before
    (tmp_path / "one.vtu").unlink()
    with pytest.raises(InputError, match="cannot be read"):
        fingerprint(one)


def test_an_ambient_history_counts_by_its_content(coarse_data, tmp_path):
    """Temperatures are above the ambient's first value."""
    table = tmp_path / "ambient.csv"
    case = case_of(coarse_data | {"ambient": {"file": "ambient.csv"}}, tmp_path)
    digests = []
    for first in (20.0, 20.0, 21.0):
        table.write_text(f"time_s,ambient_degC\n0,{first}\n3600,22\n")
        digests.append(fingerprint(case))
    assert digests[0] == digests[1] != digests[2]


def refused(path, case, match):
    with pytest.raises(InputError, match=match) as error:
        load_state(path, case)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(saved, coarse_case, tmp_path, share):
    content = saved[0].read_bytes()
    part = tmp_path / "part.npz"
    part.write_bytes(content[: int(share * len(content))])
    refused(part, coarse_case, "not a readable state, perhaps truncated")


def test_files_of_another_kind_are_refused(coarse_case, tmp_path):
    path = tmp_path / "state.npz"
    refused(path, coarse_case, "no such file")
    path.write_text("no zip")
    refused(path, coarse_case, "not a readable state")
    np.savez(path, header=np.array("{}"))
    refused(path, coarse_case, "not a march's state")
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    refused(path, coarse_case, "not a readable state")


def rewritten(saved, tmp_path, header=None, **arrays):
    """The saved file with parts of it replaced."""
    with np.load(saved[0]) as content:
        parts = dict(content)
    parts["header"] = np.array(json.dumps(json.loads(str(parts["header"])) | (header or {})))
    path = tmp_path / "state.npz"
    np.savez(path, **(parts | arrays))
    return path


@pytest.mark.parametrize(
    ("header", "match"),
    [
        ({"schema": "thermojoint-model"}, "not a march's state"),
        ({"schema_version": 3}, "state of version 3, expected 12"),
        ({"case": "0" * 64}, "state of another structure"),
        ({"index": -1}, "values are damaged"),
        ({"index": "30"}, "values are damaged"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(saved, coarse_case, tmp_path, header, match):
    refused(rewritten(saved, tmp_path, header), coarse_case, match)


def test_damaged_values_are_refused(saved, coarse_case, tmp_path):
    state = saved[1]
    for name, array in {
        "temperature": np.where(np.arange(state.temperature.size) == 5, np.nan, state.temperature),
        "gap": state.gap[:, 1:],
        "slip": state.slip.astype(int),
        "change": state.change.ravel(),
    }.items():
        path = rewritten(saved, tmp_path, **{name: array})
        refused(path, coarse_case, "values are damaged")


@pytest.mark.parametrize("seconds", [30.0, 60.0, 62.0])
def test_a_state_too_near_the_end_is_refused(saved, coarse_data, coarse_setup, tmp_path, seconds):
    case = case_of(coarse_data, tmp_path, march={"duration_min": seconds / 60.0})
    with pytest.raises(InputError, match=r"is at 60 s already.*make march\.duration_min longer"):
        simulate(case, setup=coarse_setup, start=saved[1])


def test_a_state_of_the_same_case_fits_a_machine_set_up_anew(saved, coarse_data, tmp_path):
    case = case_of(coarse_data, tmp_path, march={"duration_min": 1.1})
    state = load_state(saved[0], case)
    assert state.temperature.size == set_up(case).machine.thermal.inputs.shape[0]
