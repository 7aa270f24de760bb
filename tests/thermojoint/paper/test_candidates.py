"""Candidates of a case that gives none: spread over the heated body and over its joints."""

from collections import Counter

import numpy as np
import pytest

from fesim.setup.structure import build_structure
from thermojoint.paper.candidates import EACH, spread, with_candidates


@pytest.mark.parametrize("heated", [{}, {"surface": None, "body": "column"}], ids=["face", "body"])
def test_candidates_are_nodes_of_their_bodies_beside_the_probes_of_the_case(coarse_case, heated):
    sources = {name: one.model_copy(update=heated) for name, one in coarse_case.sources.items()}
    case = coarse_case.model_copy(update={"sources": sources})
    structure = build_structure(case)
    found = with_candidates(case, structure).probes
    assert {name: found[name] for name in case.probes} == case.probes
    new = [probe for name, probe in found.items() if name not in case.probes]
    of_bodies = Counter(probe.body for probe in new)
    # Those of the joint are on both of its sides.
    assert set(of_bodies) == {"column", "table"}
    assert 10 < len(new) <= 2 * EACH
    for probe in new:
        nodes = structure.mesh.t[:, structure.bodies[probe.body]]
        points = 1e3 * structure.mesh.p[:, np.unique(nodes)].T
        assert np.linalg.norm(points - probe.position_mm, axis=1).min() < 1e-3


def test_points_are_as_far_from_each_other_as_possible_and_none_is_taken_twice():
    line = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    assert spread(line, 3) == [2, 0, 4]
    assert sorted(spread(line, 10)) == [0, 1, 2, 4]
