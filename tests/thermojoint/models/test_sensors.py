"""Which probe of a response is the sensor of a model."""

import pytest

from thermojoint.artefacts.errors import InputError
from thermojoint.models.sensors import roles_in


def test_a_sensor_is_the_probe_of_its_name_or_else_the_one_at_its_place(
    coarse_response, hand_made_model
):
    same = {name: name for name in ("a", "b", "T1", "T2")}
    assert roles_in(coarse_response, hand_made_model) == same
    renamed = coarse_response.assign_coords(probe=["a", "b", "foot", "T2"])
    assert roles_in(renamed, hand_made_model) == same | {"T1": "foot"}


def test_a_sensor_where_no_probe_is_has_the_nearest_named(coarse_response, hand_made_model):
    with pytest.raises(InputError, match=r"no probe at sensor 'T1' .* the nearest, 'b', is 0\.08"):
        roles_in(coarse_response.isel(probe=[0, 1, 3]), hand_made_model)
