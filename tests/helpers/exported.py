"""Exported programs, compiled and run, for the tests."""

import ctypes
import re
import shutil
import subprocess
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from observed import estimates

from estimator.export.c_source import c_files
from estimator.export.fmu import write_fmu
from estimator.export.program import COMMON, Precision
from estimator.interface import Status

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc (Debian: gcc)")
needs_gxx = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++ (Debian: g++)")

#: Where double precision alone runs the same lines, and takes as long.
PRECISIONS = [Precision.DOUBLE, pytest.param(Precision.SINGLE, marks=pytest.mark.long)]

STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wshadow", "-Wconversion"]
SANITISED = ["-fsanitize=address,undefined,float-divide-by-zero", "-fno-sanitize-recover=all"]


def written(found, folder):
    folder.mkdir(exist_ok=True)
    for name, text in c_files(found).items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def as_in_python(found, estimator, rows, folder, within=1e-11):
    """Estimates of a program for samples in which readings may be missing: those of Python, m.

    The program is unsettled wherever Python is, and may be so for longer.
    """
    got = list(compiled(found, folder)([row[1:] for row in rows]))
    _, there = estimates(estimator, rows)
    for one, other in zip(got, there, strict=True):
        assert one.status & COMMON in (int(other.status), int(other.status | Status.UNSETTLED))
        expected = pytest.approx(list(other.displacement), rel=0.0, abs=within)
        assert list(one.displacement) == expected
    return got


def library(found, folder):
    """The program as a shared library."""
    written(found, folder)
    command = ["gcc", "-std=c99", "-O1", "-shared", "-fPIC", f"{found.name}.c", "-lm", "-o", "p.so"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "p.so"))


def compiled(found, folder):
    """The function of a program that takes rows of readings and gives estimates.

    With the interval of every row, s, where any is supported.
    """
    number = ctypes.c_double if found.precision is Precision.DOUBLE else ctypes.c_float
    sizes = Counter(one.place.partition("[")[0] for one in found.interface.outputs)
    arrays = {one.place.partition("[")[0] for one in found.interface.outputs if "[" in one.place}
    steps = [] if found.interface.timed else [("newton_steps", ctypes.c_int)]
    fields = (
        *((name, number * size if name in arrays else number) for name, size in sizes.items()),
        *steps,
        ("status", ctypes.c_uint),
    )
    estimate = type("Estimate", (ctypes.Structure,), {"_fields_": fields})
    loaded = library(found, folder)

    def given(rows):
        state = ctypes.create_string_buffer(found.state)
        loaded.m_init(state)
        for row in rows:
            result = estimate()
            values = (number * len(found.interface.inputs))(*row[-len(found.interface.inputs) :])
            interval = [number(row[0])] if found.interface.timed else []
            word = loaded.m_step(state, *interval, ctypes.byref(values), ctypes.byref(result))
            assert word == result.status
            yield result

    return given


def co_simulated(found, path, standard, rows):
    """Displacements that a unit for co-simulation gives for rows of times and inputs."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
    from fmpy.validation import validate_fmu

    write_fmu(found, path, standard)
    assert validate_fmu(str(path)) == []
    step, names = found.interface.interval, [one.name for one in found.interface.inputs]
    result = fmpy.simulate_fmu(
        str(path),
        input=np.array(rows, dtype=[("time", float), *((name, float) for name in names)]),
        start_time=rows[0][0],
        stop_time=rows[-2][0],
        step_size=step,
        output_interval=step,
        output=["displacement_x", "status"],
    )
    assert len(result) > 50
    return result["displacement_x"][1:]


def selftest(folder, name, *flags):
    """Compile a program and its self-test and run it, which passes; gives its figures."""
    sources = [f"{name}.c", f"{name}_selftest.c"]
    subprocess.run(["gcc", *STRICT, *flags, *sources, "-lm", "-o", "t"], cwd=folder, check=True)
    done = subprocess.run(["./t"], cwd=folder, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = re.findall(r"^([a-z ]+?) (-?[\d.e+-]+)", done.stdout, re.M)
    return {key: float(value) for key, value in figures}


#: Numbers that count what is done with them: prepended to a program that is compiled as C++.
COUNTED = """
struct Counted { double value; static long mul, add, div, fun;
  Counted() = default; constexpr Counted(double v) : value(v) {}
  explicit operator int() const { return (int)value; }
  explicit operator long() const { return (long)value; } };
inline long Counted::mul, Counted::add, Counted::div, Counted::fun;
#define OP(o, n) \\
inline Counted operator o(Counted a, Counted b) { Counted::n++; return a.value o b.value; } \\
inline Counted &operator o##=(Counted &a, Counted b) { a = a o b; return a; }
OP(*, mul) OP(+, add) OP(-, add) OP(/, div)
inline Counted operator-(Counted a) { return -a.value; }
#define CMP(o) inline bool operator o(Counted a, Counted b) { return a.value o b.value; }
CMP(<) CMP(<=) CMP(>) CMP(>=) CMP(==) CMP(!=)
#include <math.h>
#define FUN(f) inline Counted f(Counted a) { Counted::fun++; return f(a.value); }
FUN(exp) FUN(log) FUN(sin) FUN(cos) FUN(sqrt) FUN(erfc)
inline Counted fabs(Counted a) { return fabs(a.value); }
inline Counted pow(Counted a, Counted b) { Counted::fun++; return pow(a.value, b.value); }
#define CLEAR() (Counted::mul = Counted::add = Counted::div = Counted::fun = 0)
#define PRINT() printf("%ld %ld %ld %ld\\n", Counted::mul, Counted::add, Counted::div, \\
                       Counted::fun)
"""


def counts(found, folder, name, body):
    """Multiplications, additions, divisions and functions of each of some samples."""
    written(found, folder)
    header = (folder / f"{name}.h").read_text()
    (folder / f"{name}.h").write_text(header.replace("typedef double", "typedef Counted"))
    text = f'{COUNTED}\n#include "{name}.c"\n#include <stdio.h>\n{body}'
    (folder / "all.cpp").write_text(text)
    subprocess.run(["g++", "-std=c++17", "-O1", "-w", "all.cpp", "-o", "c"], cwd=folder, check=True)
    done = subprocess.run(["./c"], cwd=folder, check=True, capture_output=True, text=True)
    return [[int(value) for value in line.split()] for line in done.stdout.splitlines()]


def operations(one):
    return [one.multiplications, one.additions, one.divisions, one.functions]


def with_no_step(program):
    """The program of a joint-aware estimator that gives up before its first Newton step."""
    return replace(program, values=program.values | {"iterations": 0, "damped_steps": 0})
