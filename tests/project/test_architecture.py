"""The arrows between the packages run one way, and the tests hold the page that says so."""

import ast
import tomllib

import pytest
from repository import ROOT, TOP, modules

#: Package to what it may import, in the order of docs/architecture.md.
ARROWS = {
    "thermojoint.artefacts": set(),
    "meshes": {"thermojoint.artefacts"},
    "thermojoint.models": {"thermojoint.artefacts"},
    "fesim": {"thermojoint.artefacts", "meshes"},
    "thermojoint.verification": {"thermojoint.artefacts", "meshes", "fesim"},
    "thermojoint.sensitivity": {"thermojoint.artefacts", "meshes", "fesim"},
    "thermojoint.optimisation": {"thermojoint.artefacts", "fesim", "thermojoint.sensitivity"},
    "thermojoint.reduced": {"thermojoint.artefacts", "fesim"},
    "estimator": {"thermojoint.artefacts", "thermojoint.models", "fesim", "thermojoint.reduced"},
    "calibrate": {
        "thermojoint.artefacts",
        "thermojoint.models",
        "fesim",
        "thermojoint.reduced",
        "estimator",
    },
    "thermojoint.standards": {"thermojoint.artefacts"},
    "thermojoint.compensation": {
        "thermojoint.artefacts",
        "thermojoint.models",
        "fesim",
        "thermojoint.reduced",
        "estimator",
    },
    "thermojoint.live": {
        "thermojoint.artefacts",
        "thermojoint.models",
        "fesim",
        "thermojoint.reduced",
        "estimator",
        "thermojoint.compensation",
    },
}


def package_of(name):
    """Package of the table that a module stands in; what is not in the table stands above it."""
    return next((p for p in ARROWS if f"{name}.".startswith(f"{p}.")), None)


def imported(path):
    """Every module that a file names in an import, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides its arrow"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.fixture(scope="module")
def files():
    """Every module of ours to its file."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for package in TOP
        for path in modules(package)
    }


@pytest.fixture(scope="module")
def below(files):
    """Every module to the modules of ours that it imports."""
    return {
        name: {other for other in imported(path) if other in files} - {name}
        for name, path in files.items()
    }


@pytest.mark.parametrize("package", ARROWS)
def test_a_package_imports_only_what_stands_below_it(package, below):
    own = {name: found for name, found in below.items() if package_of(name) == package}
    assert own
    for name, found in own.items():
        known = {package_of(other) for other in found - {"thermojoint"}}
        assert known <= ARROWS[package] | {package}, name


def test_no_two_modules_import_each_other_at_the_top(below):
    """A cycle of modules inside a package is a knot as well."""
    done: set[str] = set()

    def visit(name, above):
        assert name not in above, " -> ".join([*above, name])
        if name not in done:
            for other in below[name]:
                visit(other, (*above, name))
            done.add(name)

    for name in below:
        visit(name, ())


def test_no_two_folders_know_each_other(below):
    """Of two folders beside each other at most one imports from the other, at every depth."""
    arrows = {}
    for name, found in below.items():
        for other in found:
            ours, theirs = name.split("."), other.split(".")
            same = next(
                (k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), None
            )
            if same:  # below the same package; those at the top are in the table
                ends = ".".join(ours[: same + 1]), ".".join(theirs[: same + 1])
                arrows.setdefault(ends, f"{name} -> {other}")
    for (one, other), arrow in arrows.items():
        assert (other, one) not in arrows, f"{arrow}, and {arrows[other, one]}"


def test_the_page_of_the_architecture_names_every_package():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    for package in ARROWS:
        assert f"`{package}`" in page


def test_the_wheel_and_the_type_checker_take_every_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    found = project["setuptools"]["packages"]["find"]["include"]
    assert set(found) == {f"{package}*" for package in TOP}
    assert set(project["mypy"]["packages"]) == {*TOP, "benchmarks"}
