"""Structured Text compiled by matiec (Beremiz, OpenPLC), and its self-test run."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from structured_text import run as run_structured_text

from estimator.export.structured_text import st_files

_COMPILER = shutil.which("iec2c")
#: Its standard functions, and what the C that it writes includes.
_LIBRARY = Path(_COMPILER or "/usr/local/bin/iec2c").resolve().parents[1] / "lib" / "matiec"
needs_matiec = pytest.mark.skipif(
    not (_COMPILER and _LIBRARY.is_dir()), reason="needs matiec: bin/iec2c and lib/matiec"
)
#: Like a task of a control: the same program again and again, as its memory was left.
_MAIN = """
#include <stdio.h>
#include "iec_std_lib.h"
TIME __CURRENT_TIME; BOOL __DEBUG;
#include "POUS.h"
#include "POUS.c"
int main(void)
{{
    static PRG_{name}_SELFTEST all;
    PRG_{name}_SELFTEST_init__(&all, 0);
    while (!__GET_VAR(all.FINISHED,)) PRG_{name}_SELFTEST_body__(&all);
    printf("samples %d\\nlargest difference %.17g\\n", (int)__GET_VAR(all.SAMPLE,),
        (double)__GET_VAR(all.WORST,));
    printf("agrees %d\\n", (int)__GET_VAR(all.AGREES,));
}}
"""


def selftest_by_matiec(files, name, folder):
    """Compile a program and its self-test and run it; gives its figures."""
    source = folder / "all.st"
    source.write_text(files[f"{name}.st"] + files[f"{name}_selftest.st"], encoding="utf-8")
    command = [_COMPILER, "-I", _LIBRARY, "-T", folder, source]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (folder / "main.c").write_text(_MAIN.format(name=name.upper()), encoding="utf-8")
    command = ["gcc", "-O0", "-w", f"-I{_LIBRARY}/C", "main.c", "-lm", "-o", "t"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(["./t"], cwd=folder, check=True, capture_output=True, text=True)
    return {key: float(value) for key, value in re.findall(r"^([a-z ]+) (\S+)$", done.stdout, re.M)}


def selftest_by_both(program, folder):
    """Run the self-test of a function block as it is read here and by matiec; gives its figures."""
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
    files = st_files(program)
    figures = run_structured_text(files, "m", folder)
    assert figures["agrees"] == selftest_by_matiec(files, "m", folder)["agrees"] == 1
    return figures
