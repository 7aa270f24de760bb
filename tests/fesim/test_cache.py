"""The cache of condensations: the same results sooner, nothing stale, nothing damaged."""

import copy
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from repository import ROOT

from fesim import cache
from fesim.case.identity import elasticity_key, thermal_key
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from meshes.exchange import write_structure
from thermojoint.artefacts.source import source_digest


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


@dataclass(frozen=True)
class Pair:
    """Something worth keeping."""

    numbers: np.ndarray
    factor: float


def pair(key="key", made=None, limit=cache.LIMIT):
    def make():
        if made is not None:
            made.append(key)
        return Pair(np.arange(1000.0), 0.1)

    return cache.remembered(Pair, key, make, limit=limit)


@pytest.fixture
def reduced(coarse_data):
    data = copy.deepcopy(coarse_data)
    data["march"]["thermal"] = "reduced"
    return data


def case_of(data):
    return case_from_data(data, "case", Path())


def test_a_set_up_from_the_cache_is_a_copy_and_marches_the_same(folder, reduced, monkeypatch):
    case = case_of(reduced)
    fresh = set_up(case)

    def factorise(*given):
        raise AssertionError("there is nothing to factorise")

    with monkeypatch.context() as within:
        for place in ("substructures.factorise_upper", "reduction.shifted_factors"):
            within.setattr(f"fesim.solid.{place}", factorise)
        stored = set_up(case)
        one, other = (simulate(case, setup=setup).response for setup in (fresh, stored))
    for name, value in vars(fresh.modes).items():
        np.testing.assert_array_equal(getattr(stored.modes, name), value)
    for name in ("displacement", "temperature", "pressure"):
        scale = np.abs(one[name]).max()
        np.testing.assert_allclose(other[name], one[name], rtol=0.0, atol=1e-9 * scale)
    # The elastic part, the modes, and the errors of both meshes.
    assert len(list(folder.glob("[!.]*.npz"))) == 4


def test_displacement_fields_are_there_without_their_condensation(folder, reduced):
    case = case_of(reduced)
    fresh, stored = set_up(case), set_up(case)
    rng = np.random.default_rng(1)
    temperature = rng.normal(size=fresh.spaces.heat.N)
    remainder = 1e6 * rng.normal(size=3 * fresh.machine.contact.count)
    # Two factorisations of one stiffness, each with its own rounding.
    kept, made = (one.field.solve(temperature, remainder) for one in (stored, fresh))
    np.testing.assert_allclose(kept, made, rtol=0.0, atol=1e-9 * np.abs(made).max())


def test_the_full_thermal_model_shares_the_elastic_condensation(folder, coarse_data, reduced):
    set_up(case_of(coarse_data))
    entries = set(folder.glob("*.npz"))
    set_up(case_of(reduced))
    assert entries < set(folder.glob("*.npz"))
    assert len(set(folder.glob("[!.]*.npz")) - entries) == 1


def test_any_step_from_a_second_on_is_served_by_the_same_modes(folder, reduced):
    steps = (2.0, 5.0, 60.0)
    ranks = {set_up(case_of(with_step(reduced, step))).modes.rates.size for step in steps}
    assert len(list(folder.glob("[!.]*.npz"))) == 3
    assert len(ranks) == 1
    set_up(case_of(with_step(reduced, 0.25)))
    assert len(list(folder.glob("*.npz"))) == 4


def with_step(data, step):
    changed = copy.deepcopy(data)
    changed["march"]["step_s"] = step
    return changed


CHANGES = {
    "a modulus": ("materials", "cast_iron", "youngs_modulus_GPa"),
    "an expansion": ("materials", "cast_iron", "expansion_1_K"),
    "an element size": ("structure", "element_size_mm"),
    "a number of contact elements": ("joints", "knee", "along"),
}
OF_THE_HEAT = {
    "a conductivity": ("materials", "cast_iron", "conductivity_W_mK"),
    "a heat capacity": ("materials", "cast_iron", "heat_capacity_J_kgK"),
    "a film": ("convection_W_m2K", "exterior"),
}


def changed(data, place):
    made = copy.deepcopy(data)
    section = made
    for key in place[:-1]:
        section = section[key if key is not None else next(iter(section))]
    section[place[-1]] += 1
    return case_of(made)


@pytest.mark.parametrize("place", CHANGES.values(), ids=CHANGES)
def test_what_enters_the_condensation_makes_another_entry(coarse_data, place):
    assert elasticity_key(changed(coarse_data, place)) != elasticity_key(case_of(coarse_data))


@pytest.mark.parametrize("place", OF_THE_HEAT.values(), ids=OF_THE_HEAT)
def test_what_enters_the_heat_only_leaves_the_elastic_part(coarse_data, place):
    one, other = changed(coarse_data, place), case_of(coarse_data)
    assert elasticity_key(one) == elasticity_key(other)
    assert thermal_key(one) != thermal_key(other)


def elsewhere(data):
    """The same machine heated, cooled and read in other places."""
    made = copy.deepcopy(data)
    (source,) = made["sources"].values()
    source["surface"] = "rear"
    made["convection_W_m2K"] = {"interior": 9.0}
    made["probes"]["T3"] = {"position_mm": [10.0, 10.0, 10.0]}
    return made


def test_another_source_film_and_probe_find_the_elastic_part(folder, reduced, monkeypatch):
    set_up(case_of(reduced))
    entries = set(folder.glob("*.npz"))

    def factorise(*given):
        raise AssertionError("the elastic part is there")

    with monkeypatch.context() as within:
        within.setattr("fesim.solid.substructures.factorise_upper", factorise)
        found = set_up(case_of(elsewhere(reduced)))
    assert len(set(folder.glob("*.npz")) - entries) == 1
    monkeypatch.setenv(cache.VARIABLE, "off")
    anew = set_up(case_of(elsewhere(reduced)))
    for name in ("compliance", "probe_compliance"):
        one, other = (getattr(made.machine.contact.elastic, name) for made in (found, anew))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12 * np.abs(other).max())
    case = case_of(elsewhere(reduced))
    one, other = (simulate(case, setup=made).response for made in (found, anew))
    np.testing.assert_allclose(one["displacement"], other["displacement"], rtol=0.0, atol=1e-12)


def test_a_displacement_point_that_moves_is_another_elastic_part(coarse_data):
    one = copy.deepcopy(coarse_data)
    one["probes"]["A"] = {"position_mm": [600.0, 1000.0, 250.0], "body": "column"}
    assert elasticity_key(case_of(one)) != elasticity_key(case_of(coarse_data))


def test_another_program_or_library_finds_nothing(folder, monkeypatch):
    made = []
    pair(made=made)
    pair(made=made)
    assert len(made) == 1
    monkeypatch.setattr(cache, "program", lambda: "another")
    pair(made=made)
    assert len(made) == 2


def test_the_program_is_its_source_and_its_libraries(monkeypatch):
    before = cache.program.__wrapped__()
    assert before == cache.program()
    monkeypatch.setattr(cache, "version", lambda name: "0.0")
    assert cache.program.__wrapped__() != before
    monkeypatch.undo()
    monkeypatch.setattr(cache, "_SOURCES", ("fesim",))
    assert cache.program.__wrapped__() != before


def test_a_source_that_is_not_there_has_no_digest():
    """A digest of nothing would be the same for every source."""
    digests = {source_digest(package) for package in cache._SOURCES}
    assert len(digests) == len(cache._SOURCES)
    with pytest.raises(ModuleNotFoundError, match="no package artefacts in"):
        source_digest("artefacts")


def test_a_mesh_that_is_written_while_it_is_read_is_not_kept(
    folder, coarse_data, coarse_setup, tmp_path, monkeypatch
):
    data = copy.deepcopy(coarse_data)
    path = tmp_path / "machine.vtu"
    write_structure(coarse_setup.structure, path)
    data["structure"] = {"kind": "mesh", "file": str(path), "symmetry_factor": 2}
    data["probes"] = {"T1": coarse_data["probes"]["T1"]}
    real = set_up.__globals__["make_parts"]

    def disturbed(case):
        parts = real(case)
        with path.open("a") as file:
            file.write("\n")
        return parts

    monkeypatch.setattr("fesim.setup.machine.make_parts", disturbed)
    set_up(case_of(data))
    assert not folder.exists()


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "no zip"])
def test_a_damaged_entry_is_made_again(folder, damage):
    made = []
    pair(made=made)
    (entry,) = folder.iterdir()
    content = bytearray(entry.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 0x10
    ends = {"cut": len(content) // 2, "empty": 0}
    entry.write_bytes(b"no zip" if damage == "no zip" else content[: ends.get(damage)])
    found = pair(made=made)
    assert len(made) == 2
    np.testing.assert_array_equal(found.numbers, np.arange(1000.0))
    pair(made=made)
    assert len(made) == 2


def test_off_means_off(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, "off")
    monkeypatch.chdir(tmp_path)
    made = []
    pair(made=made)
    pair(made=made)
    assert len(made) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "file"))
    made = []
    assert pair(made=made).factor == pair(made=made).factor == 0.1
    assert len(made) == 2


def test_what_was_not_used_for_the_longest_time_goes_first(folder):
    pair("one")
    (entry,) = folder.iterdir()
    limit = int(2.5 * entry.stat().st_size)
    now = time.time()
    made = []
    os.utime(entry, (now - 100, now - 100))
    pair("two", limit=limit)
    os.utime(newest(folder), (now - 50, now - 50))
    pair("one")  # used: now the other one is the oldest
    pair("three", limit=limit)
    pair("one", made)
    pair("three", made)
    assert made == []
    pair("two", made)
    assert made == ["two"]


def test_files_of_others_in_the_folder_stay(folder):
    pair("one")
    others = [folder / "state.npz", folder / ".mine.x.npz"]
    for path in others:
        path.write_bytes(bytes(1000))
        os.utime(path, (0.0, 0.0))
    pair("two", limit=0)
    assert all(path.exists() for path in others)
    assert len(list(folder.glob("[!.]*.npz"))) == 2  # the one used last stays


def newest(folder):
    return max(folder.iterdir(), key=lambda path: path.stat().st_mtime)


def test_what_a_killed_process_left_goes_after_a_day(folder):
    folder.mkdir()
    old, new = (f".{64 * digit}.x.npz" for digit in "01")
    for name, age in ((old, 2.0), (new, 0.5)):
        (folder / name).write_text("half")
        then = time.time() - age * cache.ABANDONED
        os.utime(folder / name, (then, then))
    pair()
    assert [path.name for path in folder.glob(".*")] == [new]


MANY = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from dataclasses import dataclass
from fesim.cache import remembered

@dataclass(frozen=True)
class Pair:
    numbers: np.ndarray
    factor: float

for turn in range(200):
    key = turn % 5
    found = remembered(Pair, str(key), lambda: Pair(np.full(20_000, float(key)), key + 0.5))
    assert found.factor == key + 0.5
    assert (found.numbers == key).all()
"""


def test_many_processes_at_once_do_not_disturb_each_other(folder):
    root = str(ROOT)
    running = [
        subprocess.Popen([sys.executable, "-c", MANY, root], stderr=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    for process in running:
        assert process.communicate(timeout=120)[1] == ""
        assert process.returncode == 0
    assert len(list(folder.iterdir())) == 5
