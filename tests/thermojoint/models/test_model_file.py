"""The model file keeps every bit, and refuses what it does not understand in one line."""

import json
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermojoint.artefacts.errors import InputError
from thermojoint.models.model_file import Provenance, read_model, read_provenance, write_model
from thermojoint.models.parameters import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Regularisation,
    Relaxation,
    RingModel,
    Span,
)

number = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=5e-324, allow_nan=False, allow_infinity=False)
regularisations = st.builds(Regularisation, number, number, positive)
shapes = st.fixed_dictionaries(
    {
        axis: st.builds(
            DeformationModel, number, number, number, positive, positive, positive, number, positive
        )
        for axis in ("x", "y")
    }
)
rings = st.builds(RingModel, number, positive, positive, positive, positive)
spectra = st.lists(st.tuples(number, positive), min_size=1, max_size=5).map(
    lambda pairs: Relaxation(tuple(c for c, _ in pairs), tuple(rate for _, rate in pairs))
)
sources = st.builds(
    FictitiousSource,
    number,
    positive,
    positive,
    positive,
    st.fixed_dictionaries({0.5: number, 2.0: number}),
    regularisations,
    shapes,
)
models = st.builds(
    Model,
    st.builds(
        LinearModel,
        rings,
        regularisations,
        shapes,
        st.fixed_dictionaries({"T1": spectra, "T2": rings}),
    ),
    st.tuples(sources, sources),
    st.tuples(st.tuples(positive, positive), st.tuples(positive, positive)),
    st.fixed_dictionaries({name: st.tuples(number, number, number) for name in "ab"}).map(
        lambda some: some | {"T1": (0.1, 0.2, 0.3), "T2": (0.3, 0.2, 0.1)}
    ),
    positive,
    st.builds(
        Span,
        positive,
        st.tuples(number, number),
        st.fixed_dictionaries({"delta_T": st.tuples(number, number)}),
    ),
)

SHAPE = {"x": DeformationModel(1e-6, 2e-6, 3e-9, 0.01, 0.001, 0.02)}
MODEL = Model(
    linear=LinearModel(
        thermal=RingModel(3.372, 3.2, 0.000212, 0.19, 0.12),
        regularisation=Regularisation(0.0168, -0.00136, 0.162),
        deformation=SHAPE,
        direct={
            "T1": Relaxation((0.1, 1.0 / 3.0), (1e-4, 1e-3)),
            "T2": Relaxation((0.2,), (2e-4,)),
        },
    ),
    sources=(
        FictitiousSource(
            -0.7, 20.0, 6e-5, 0.02, {0.5: 0.2}, Regularisation(-0.008, 6e-4, 0.13), SHAPE
        ),
    ),
    distances=((0.05, 0.12),),
    sensors={
        "a": (0.6, 0.7, 0.1),
        "b": (0.6, 0.9, 0.1),
        "T1": (0.6, 0.4, 0.1),
        "T2": (0.6, 0.7, 0),
    },
    reference_power_W=295.0,
    span=Span(2100.0, (0.0, 2.0), {"delta_T": (0.0, 8.0)}),
)
SOURCE = Provenance(
    case='title = "reference"\n',
    versions={"thermojoint": "0.1.0"},
    max_abs_error_K={"thermal": 0.003},
    max_abs_error_um={"deformation.x": 0.05},
    reports={"thermal": "K  3.372"},
    at_bound={"thermal": ["a"]},
)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "model.json"
    write_model(MODEL, path, SOURCE)
    return path


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return path


@given(models)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_every_model_comes_back_to_the_last_bit(tmp_path, model):
    path = tmp_path / "any.json"
    write_model(model, path, SOURCE)
    # repr tells -0.0 from 0.0, which == does not.
    assert repr(read_model(path)) == repr(model)


def test_where_it_came_from_comes_back(path):
    assert read_provenance(path) == SOURCE


def test_the_file_says_its_units_and_version(path):
    content = json.loads(path.read_text())
    assert content["schema"] == "thermojoint-model"
    assert content["schema_version"] == 3
    assert content["units"]["alpha"] == "m2 s-1"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(schema_version=1), "version 1, expected 3"),
        (lambda c: c.update(schema="other"), "not a 'thermojoint-model' file"),
        (lambda c: c.update(colour="red"), "colour: Unexpected keyword"),
        (lambda c: c["linear"]["thermal"].update(Kay=1.0), "linear.thermal.Kay"),
        (lambda c: c["linear"]["thermal"].pop("alpha"), "linear.thermal.alpha: Field required"),
        (lambda c: c.update(kind="joint-aware"), "of kind 'joint-aware'"),
        (lambda c: c["linear"]["thermal"].update(a=-1.0), "linear.thermal.a"),
        (lambda c: c["linear"]["thermal"].update(K="3.4"), "linear.thermal.K"),
        (lambda c: c["linear"]["thermal"].update(K=float("nan")), "linear.thermal.K"),
        (lambda c: c["linear"]["direct"]["T1"].update(colour="red"), "linear.direct.T1"),
        (lambda c: c["linear"]["direct"]["T1"]["rates"].pop(), "as many amplitudes as rates"),
        (lambda c: c["linear"]["direct"].pop("T2"), "distances: one row per source"),
        (lambda c: c["sensors"].pop("T1"), "'T1' is missing"),
        (lambda c: c["sensors"].update(a=[1.0, 2.0]), "sensors.a"),
        (lambda c: c["units"].update(K="mK"), "units differ"),
        (lambda c: c["distances"].append([0.1, 0.2]), "one row per source"),
        (lambda c: c["sources"][0]["deformation"].clear(), "axes differ"),
    ],
)
def test_a_file_that_is_not_this_model_is_refused_in_one_line(path, change, message):
    with pytest.raises(InputError) as caught:
        read_model(edit(path, change))
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.floats(0.0, 0.999))
@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_truncated_file_is_refused_wherever_it_was_cut(tmp_path, share):
    whole = tmp_path / "whole.json"
    write_model(MODEL, whole, SOURCE)
    text = whole.read_text().rstrip()
    cut = tmp_path / "cut.json"
    cut.write_text(text[: int(share * (len(text) - 1))])
    with pytest.raises(InputError, match="truncated"):
        read_model(cut)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_model(tmp_path / "none.json")


def test_a_file_of_bytes_is_refused(tmp_path):
    path = tmp_path / "model.json"
    path.write_bytes(b"\x89HDF\xff\xfe")
    with pytest.raises(InputError, match="not a text file"):
        read_model(path)


def test_a_model_with_a_value_that_is_not_finite_is_not_written_and_the_old_file_stays(path):
    before = path.read_text()
    with pytest.raises(InputError, match="not finite"):
        write_model(replace(MODEL, reference_power_W=float("nan")), path, SOURCE)
    assert path.read_text() == before


def test_a_model_that_could_not_be_read_again_is_not_written(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match="'b' is missing"):
        write_model(replace(MODEL, sensors={"a": (0.0, 0.0, 0.0)}), path, SOURCE)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_before_bounds_were_recorded_is_read(path):
    edit(path, lambda content: content["provenance"].pop("at_bound"))
    assert read_provenance(path).at_bound == {}
