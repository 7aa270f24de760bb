"""What the tests of the service share."""

import pytest

from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly


@pytest.fixture(scope="session")
def model(hand_made_model, tmp_path_factory):
    """A model of one-second samples, as a file."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    write_assembly(assemble(hand_made_model, 1.0, 7200.0), path)
    return path
