"""Tables 1-3 as data and beside the paper's values: nothing lost, nothing converted twice."""

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from thermojoint.models.model_file import Provenance
from thermojoint.models.parameters import DeformationModel
from thermojoint.paper import paper_values, printing
from thermojoint.paper.tables import NOTE, printed_tables, tables_json

ERRORS = Provenance(
    case="by hand",
    max_abs_error_K={"thermal": 0.01, "sources": 0.02},
    max_abs_error_um={
        "deformation.x": 0.05,
        "deformation.y": 0.06,
        "sources.0.5.x": 0.1,
        "sources.0.5.y": 0.2,
        "sources.2.0.x": 0.3,
        "sources.2.0.y": 0.4,
    },
)
number = st.floats(-1e3, 1e3)


def rows_of(table):
    return {(block.title, row.name): row for block in table.blocks for row in block.rows}


def test_the_json_has_the_structure_that_others_read(hand_made_model):
    tables = tables_json(hand_made_model, ERRORS)
    thermal = tables["table1"]["thermal"]
    assert set(thermal) == {"K", "a", "alpha", "r", "r0", "A", "B", "gamma", "max_abs_error_K"}
    for axis in ("x", "y"):
        shape = tables["table1"]["deformation"][axis]
        assert set(shape) == {*"CDEcde", "max_abs_error_um"}
        for source in tables["table3"][axis]["sources"]:
            assert set(source) == set("CDEFcdef")
    for source in tables["table2"]["sources"]:
        assert {"a", "alpha", "K", "q", "A", "B", "gamma"} <= set(source)
        assert set(source["q"]) == {"2.0", "0.5"}
    assert tables["table2"]["distances_m"] == [[0.10, 0.30], [0.32, 0.11]]
    assert tables["table2"]["max_abs_error_K"] == 0.02
    assert tables["table3"]["max_abs_error_um"] == {
        "0.5": {"x": 0.1, "y": 0.2},
        "2.0": {"x": 0.3, "y": 0.4},
    }
    assert tables["units"]["C"] == "um"
    assert json.loads(json.dumps(tables, allow_nan=False)) == tables


@given(values=st.tuples(number, number, number), rates=st.tuples(number, number, number))
def test_lengths_are_printed_in_micrometres_and_rates_as_they_are(hand_made_model, values, rates):
    shape = DeformationModel(*(1e-6 * value for value in values), *rates)
    linear = replace(hand_made_model.linear, deformation={"x": shape})
    shown = tables_json(replace(hand_made_model, linear=linear, sources=()), ERRORS)
    shown = shown["table1"]["deformation"]["x"]
    assert [shown[name] for name in "CDE"] == pytest.approx(values, rel=1e-12, abs=1e-300)
    assert [shown[name] for name in "cde"] == list(rates)


def test_an_error_that_the_model_does_not_record_is_missing_not_zero(hand_made_model):
    tables = tables_json(hand_made_model, Provenance(case="by hand"))
    assert tables["table1"]["thermal"]["max_abs_error_K"] is None
    assert tables["table3"]["max_abs_error_um"]["2.0"]["y"] is None


def test_every_parameter_of_the_paper_stands_beside_ours(hand_made_model):
    one, two, three = map(rows_of, printed_tables(tables_json(hand_made_model, ERRORS)))
    for name, value in paper_values.TABLE1_THERMAL.items():
        assert one["Thermal model (Eqs. 2, 7)", name].paper == value
    for axis, shape in paper_values.TABLE1_DEFORMATION.items():
        for name, value in shape.items():
            assert one[f"Deformation {axis} (Eq. 8)", name].paper == value
    for i, source in enumerate(paper_values.TABLE2):
        for name, value in source.items():
            assert two[f"Fictitious source {i + 1}", name].paper == value
    for axis, sources in paper_values.TABLE3.items():
        for i, shape in enumerate(sources):
            for name, value in shape.items():
                assert three[f"Source {i + 1}, {axis}", name].paper == value
    assert one["Thermal model (Eqs. 2, 7)", "K"].ours == hand_made_model.linear.thermal.K


def test_the_paper_has_no_value_for_a_third_source(hand_made_model):
    more = replace(hand_made_model, sources=(*hand_made_model.sources, hand_made_model.sources[0]))
    _, two, _ = map(rows_of, printed_tables(tables_json(more, ERRORS)))
    assert two["Fictitious source 3", "K"].paper is None


def test_the_terminal_shows_both_columns_and_says_why_they_differ(hand_made_model):
    terminal = Console(record=True, width=100)
    printing.show_tables(terminal, printed_tables(tables_json(hand_made_model, ERRORS)))
    text = terminal.export_text()
    assert "3.372" in text
    assert "8.25e-06" in text
    assert NOTE[:40] in text


def test_a_value_at_the_bound_of_its_fit_is_marked(hand_made_model):
    bounds = {"thermal": ["a"], "sources": ["alpha2"], "sources.x": ["d1"]}
    printed = printed_tables(tables_json(hand_made_model, ERRORS), bounds)
    marked = [
        (block.title, row.name)
        for table in printed
        for block in table.blocks
        for row in block.rows
        if row.at_bound
    ]
    assert marked == [
        ("Thermal model (Eqs. 2, 7)", "a"),
        ("Fictitious source 2", "alpha"),
        ("Source 1, x", "d"),
    ]
    terminal = Console(record=True, width=100)
    printing.show_tables(terminal, printed)
    assert terminal.export_text().count(" * ") == 3 + NOTE.count(" * ")
