"""Machine code that only machine code may call: called from Python it would end the process."""

import ast
from pathlib import Path

from repository import ROOT, TOP, modules

PART = "compiled_part"


def decorators(function):
    return {one.id for one in function.decorator_list if isinstance(one, ast.Name)}


def functions(tree):
    return [one for one in tree.body if isinstance(one, ast.FunctionDef)]


def parts(path):
    """Functions of a module that have no way in from Python."""
    return {one.name for one in functions(ast.parse(path.read_text())) if PART in decorators(one)}


def called(tree, own, ways_in):
    """Calls of such functions in what is not compiled itself, by the names that a module uses."""
    taken = set(own)
    for one in ast.walk(tree):
        if isinstance(one, ast.ImportFrom) and one.module:
            inside = ways_in.get(one.module, set())
            taken |= {name.asname or name.name for name in one.names if name.name in inside}
    compiled = [one for one in functions(tree) if decorators(one) & {"compiled", PART}]
    inside = {id(node) for one in compiled for node in ast.walk(one)}
    calls = [one for one in ast.walk(tree) if isinstance(one, ast.Call) and id(one) not in inside]
    return [one.func.id for one in calls if isinstance(one.func, ast.Name) and one.func.id in taken]


def module_of(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def test_python_calls_no_function_that_has_no_way_in_from_python():
    paths = [path for package in (*TOP, "tests", "benchmarks") for path in modules(package)]
    ways_in = {module_of(path): parts(path) for path in paths}
    assert sum(map(len, ways_in.values())) > 20
    for path in paths:
        tree = ast.parse(path.read_text())
        assert called(tree, ways_in[module_of(path)], ways_in) == [], path


def test_such_a_call_would_be_seen():
    tree = ast.parse(Path(__file__).read_text() + "\nfrom fesim.joint.in_place import add\nadd(1)")
    assert called(tree, set(), {"fesim.joint.in_place": {"add"}}) == ["add"]
