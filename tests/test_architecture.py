"""The arrows between the packages run one way, and the tests hold the page that says so."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

#: Package to what it may import, in the order of docs/architecture.md.
ARROWS = {
    "artefacts": set(),
    "meshes": {"artefacts"},
    "models": {"artefacts"},
    "fesim": {"artefacts", "meshes"},
    "verification": {"artefacts", "meshes", "fesim"},
    "calibrate": {"artefacts", "models"},
    "estimator": {"artefacts", "models", "fesim"},
    "standards": {"artefacts"},
    "compensation": {"artefacts", "models", "fesim", "estimator"},
    "live": {"artefacts", "models", "fesim", "estimator", "compensation"},
    "thermojoint": {
        "artefacts",
        "meshes",
        "models",
        "fesim",
        "verification",
        "calibrate",
        "estimator",
        "standards",
        "compensation",
        "live",
    },
}


def modules(package):
    return sorted((ROOT / package).rglob("*.py"))


def imported(path):
    """Every module that a file names in an import, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides its arrow"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("package", ARROWS)
def test_a_package_imports_only_what_stands_below_it(package):
    for path in modules(package):
        known = {name.split(".")[0] for name in imported(path)} & set(ARROWS)
        assert known <= ARROWS[package] | {package}, path


def test_no_two_modules_import_each_other_at_the_top():
    """A cycle of modules inside a package is a knot as well."""
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for package in ARROWS
        for path in modules(package)
    }
    below = {
        name: {other for other in imported(path) if other in files} for name, path in files.items()
    }
    done: set[str] = set()

    def visit(name, above):
        assert name not in above, " -> ".join([*above, name])
        if name not in done:
            for other in below[name]:
                visit(other, (*above, name))
            done.add(name)

    for name in below:
        visit(name, ())


def test_the_page_of_the_architecture_names_every_package():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    for package in ARROWS:
        assert f"`{package}`" in page


def test_the_wheel_and_the_type_checker_take_every_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    found = project["setuptools"]["packages"]["find"]["include"]
    assert set(found) == {f"{package}*" for package in ARROWS}
    assert set(project["mypy"]["packages"]) == set(ARROWS)
