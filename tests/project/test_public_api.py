"""What `import thermojoint` offers: one list of names, cheap to import, typed and documented."""

import ast
import inspect
import os
import pkgutil
import re
import subprocess
import sys

import pytest
from repository import ROOT, TOP, modules

import thermojoint

#: What takes long to import.
LIBRARIES = {"matplotlib", "numba", "numpy", "pandas", "pydantic", "scipy", "skfem", "xarray"}
FRONT = ast.parse((ROOT / "thermojoint" / "__init__.py").read_text("utf-8"))


def test_type_checkers_see_what_is_loaded():
    [block] = [node for node in FRONT.body if isinstance(node, ast.If) and not node.orelse][:1]
    seen = {
        alias.asname: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    renamed = [node for node in block.body if isinstance(node, ast.Assign)]
    seen |= {node.targets[0].id: seen.pop(node.value.id) for node in renamed}
    assert seen == thermojoint._HOMES
    assert sorted(seen) == sorted(thermojoint.__all__)


def test_no_public_name_is_a_module_of_the_package():
    """Importing a module makes it an attribute: it would hide the name."""
    inside = {module.name for module in pkgutil.iter_modules(thermojoint.__path__)}
    assert not inside & set(thermojoint.__all__)


def test_importing_the_package_loads_no_library():
    done = subprocess.run(
        [sys.executable, "-c", "import sys, thermojoint; print(*sys.modules)"],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & (LIBRARIES | set(TOP) - {"thermojoint"})


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        thermojoint.simulat  # noqa: B018


def test_the_version_is_a_number():
    assert re.fullmatch(r"\d+\.\d+\.\d+", thermojoint.__version__)


def documented(docstring, section):
    """Names that a numpydoc section lists, or None without the section."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=^\S[^\n]*\n---+$|\Z)", docstring, re.M | re.S)
    if found is None:
        return None
    entries = [line for line in found[1].splitlines() if line and not line[0].isspace()]
    return [name.strip(" *") for line in entries for name in line.split(" : ")[0].split(",")]


def callables(name):
    """A public function, or the public methods of a public class."""
    thing = getattr(thermojoint, name)
    if inspect.isfunction(thing):
        return [thing]
    # Methods of libraries, such as pydantic's, are documented there.
    return [
        member
        for key, member in inspect.getmembers(thing, inspect.isfunction)
        if not key.startswith("_") and member.__module__.split(".")[0] in TOP
    ]


@pytest.mark.parametrize("name", thermojoint.__all__)
def test_a_public_name_says_what_it_is(name):
    first = (getattr(thermojoint, name).__doc__ or "").split("\n")[0]
    assert re.search(r"[.:]$", first), name


@pytest.mark.parametrize("name", thermojoint.__all__)
def test_a_public_function_has_types_and_documents_every_parameter(name):
    for function in callables(name):
        signature = inspect.signature(function)
        given = [one for one in signature.parameters.values() if one.name != "self"]
        assert signature.return_annotation is not signature.empty, function
        assert all(one.annotation is not one.empty for one in given), function
        if given:
            listed = documented(inspect.getdoc(function), "Parameters") or []
            assert set(listed) == {one.name for one in given}, function


def functions(tree):
    """Public functions and methods of a module or a class."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node)


@pytest.mark.parametrize("package", TOP)
def test_a_list_of_parameters_is_that_of_the_signature(package):
    for path in modules(package):
        for node in functions(ast.parse(path.read_text("utf-8"))):
            listed = documented(ast.get_docstring(node) or "", "Parameters")
            if listed is not None:
                taken = node.args
                every = [*taken.posonlyargs, *taken.args, taken.vararg, *taken.kwonlyargs]
                names = {one.arg for one in (*every, taken.kwarg) if one} - {"self", "cls"}
                assert set(listed) == names, f"{path}: {node.name}"
                assert len(set(listed)) == len(listed), f"{path}: {node.name}"


@pytest.mark.parametrize("package", TOP)
def test_a_package_carries_its_types_to_its_users(package):
    assert (ROOT / package / "py.typed").is_file()


#: Packages that 0.1 installed at the top level, under everyday names.
FORMER = ("artefacts", "compensation", "live", "models", "standards", "verification")


def run_beside_modules(folder, names, text, script="script.py"):
    """Run a script in a folder that holds modules of these names, as a user would."""
    for name in names:
        (folder / f"{name}.py").write_text("mine = True\n", "utf-8")
    path = folder / script
    path.write_text(text, "utf-8")
    return subprocess.run(
        [sys.executable, str(path)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )


def test_a_users_own_modules_may_have_any_former_name(tmp_path):
    text = (
        f"import {', '.join(FORMER)}\nimport thermojoint as tj\n"
        "assert tj.read_model and tj.simulate and tj.close_loop\n"
        f"assert all(module.mine for module in ({', '.join(FORMER)}))\n"
    )
    done = run_beside_modules(tmp_path, FORMER, text)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", sorted(set(TOP) - {"thermojoint"}))
@pytest.mark.parametrize("how", ["imported before", "on the path", "the script itself"])
def test_a_users_module_that_hides_a_package_is_named_at_import(tmp_path, name, how):
    text = f"import {name}\n" * (how == "imported before") + "import thermojoint\n"
    script = f"{name}.py" if how == "the script itself" else "script.py"
    done = run_beside_modules(tmp_path, (name,), text, script)
    assert done.returncode == 1
    path = tmp_path / f"{name}.py"
    assert done.stderr.splitlines()[-1] == (
        f"ImportError: {path} hides the package {name!r} of thermojoint; rename it"
    )
