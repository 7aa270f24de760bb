"""What is installed: the tested versions with their hashes, and every extra of the program."""

import re
import tomllib

import pytest
from packaging.requirements import Requirement
from repository import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
#: Extras for those who work on the program.
OURS = {"dev", "docs"}


def plain(name):
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.fixture(scope="module")
def tested():
    """Name to the requirement and the hashes of constraints.txt."""
    text = (ROOT / "constraints.txt").read_text("utf-8").replace("\\\n", " ")
    found = {}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            requirement, *hashes = line.split("--hash=")
            one = Requirement(requirement)
            found[plain(one.name)] = one, hashes
    return found


def test_every_tested_version_is_one_and_has_hashes(tested):
    for one, hashes in tested.values():
        (specifier,) = one.specifier
        assert specifier.operator == "==", one
        assert hashes, one
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", value.strip()) for value in hashes), one


def test_whatever_the_program_and_its_extras_need_has_a_tested_version(tested):
    extras = PROJECT["optional-dependencies"]
    needed = [
        *PROJECT["dependencies"],
        *(one for name, extra in extras.items() if name not in OURS for one in extra),
    ]
    for requirement in map(Requirement, needed):
        found, _ = tested.get(plain(requirement.name), (None, ()))
        assert found, f"{requirement}: run 'make constraints'"
        (version,) = found.specifier
        assert version.version in requirement.specifier, f"{requirement}: run 'make constraints'"


def test_the_makefile_knows_every_extra():
    text = (ROOT / "Makefile").read_text("utf-8")
    (listed,) = re.findall(r"^EXTRAS := (.*)$", text, re.M)
    assert set(listed.split()) == set(PROJECT["optional-dependencies"]) - OURS
