"""Thousands of damaged inputs: each must end in a result or in one line that says what is wrong.

Case files, meshes and histories are mutated at random (from a seed) and given to
``thermojoint simulate``; some of them are named as its output, too. An input passes if the command
ends in time, with exit code 0 and a whole response, or with exit code 2, one line on standard error
and no file left behind, and if no input file has changed.

Run: ``python -m benchmarks.fuzz --count 3000 [--seed N] [--markdown docs/damaged-inputs.md]``.
Failing inputs are kept in the folder that ``--keep`` names; the exit code is 1 if there are any.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from importlib import import_module
from multiprocessing.context import ForkProcess
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.fuzz_inputs import WRITERS, Files, unharmed
from benchmarks.study import options_of
from thermojoint.artefacts.files import write_text
from thermojoint.artefacts.response import read_response
from thermojoint.cli.main import main as thermojoint

HEADER = ["damage", "result", "refused in one line", "failed"]
#: An input that takes longer than this is a hang, s; the unharmed ones take about one.
LIMIT_S = 60.0
#: Address space of one run: a case that asks for more must have been refused, bytes.
MEMORY = 8 << 30
#: The output of this part of the runs is one of their inputs.
SLIPS = 0.02
OUT = "out.nc"
#: Imports of a simulation, loaded once instead of in every process.
LOADED = (
    *("thermojoint.cli.app", "thermojoint.paper.summary"),
    *("fesim.joint.compiled_gap", "fesim.snapshots", "fesim.march.state_file"),
)

#: Replacements of a number.
NUMBERS = [
    *("nan", "inf", "-inf", "0", "0.0", "-1", "-1.0", "1e300", "-1e300", "1e-300", "1e9", "1e-9"),
    *("1", "2", "3.7", "1000", "true", '"x"', "[]", "{}", "1e400", "0x10", "99999999999999999999"),
]

Mutation = Callable[[bytes, np.random.Generator], bytes]


def flip(content: bytes, random: np.random.Generator) -> bytes:
    """Some bits the other way."""
    changed = bytearray(content)
    for at in random.integers(0, len(changed), random.integers(1, 4)):
        changed[at] ^= 1 << int(random.integers(0, 8))
    return bytes(changed)


def cut(content: bytes, random: np.random.Generator) -> bytes:
    """The end is missing."""
    return content[: int(random.integers(0, len(content)))]


def hole(content: bytes, random: np.random.Generator) -> bytes:
    """A span is missing."""
    start = int(random.integers(0, len(content)))
    return content[:start] + content[start + int(random.integers(1, 40)) :]


def stammer(content: bytes, random: np.random.Generator) -> bytes:
    """A span is there twice."""
    start = int(random.integers(0, len(content)))
    end = start + int(random.integers(1, 60))
    return content[:end] + content[start:end] + content[end:]


def lines_swapped(content: bytes, random: np.random.Generator) -> bytes:
    """Two lines have changed places."""
    lines = content.splitlines(keepends=True)
    i, j = random.integers(0, len(lines), 2)
    lines[i], lines[j] = lines[j], lines[i]
    return b"".join(lines)


def line_lost(content: bytes, random: np.random.Generator) -> bytes:
    """A line is missing."""
    lines = content.splitlines(keepends=True)
    del lines[int(random.integers(0, len(lines)))]
    return b"".join(lines)


def other_number(content: bytes, random: np.random.Generator) -> bytes:
    """A number has become something else, or is off by a power of ten."""
    places = list(re.finditer(rb"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?(?![\w.])", content[:200_000]))
    if not places:
        return flip(content, random)
    at = places[int(random.integers(0, len(places)))]
    if random.random() < 0.5:
        new = str(random.choice(NUMBERS)).encode()
    else:
        new = f"{float(at.group()) * 10.0 ** random.integers(-4, 5):g}".encode()
    return content[: at.start()] + new + content[at.end() :]


def other_word(content: bytes, random: np.random.Generator) -> bytes:
    """A word is replaced by another one, or misspelt."""
    places = list(re.finditer(rb"[A-Za-z_]{3,}", content[:200_000]))
    if not places:
        return flip(content, random)
    i, j = random.integers(0, len(places), 2)
    word = places[j].group() if random.random() < 0.5 else places[i].group()[::-1]
    return content[: places[i].start()] + word + content[places[i].end() :]


MUTATIONS: Mapping[str, Mutation] = {
    "number": other_number,
    "word": other_word,
    "line lost": line_lost,
    "lines swapped": lines_swapped,
    "hole": hole,
    "stammer": stammer,
    "flip": flip,
    "cut": cut,
}


def mutated(files: Files, name: str, random: np.random.Generator) -> tuple[str, Files]:
    """Return the kind of damage, and the files with one to three damages in one of them."""
    kinds = random.choice(list(MUTATIONS), 1 + int(random.binomial(2, 0.2)))
    content = files[name]
    for kind in kinds:
        content = MUTATIONS[kind](content, random) or b" "
    return f"{name.split('.')[-1]}: {kinds[0]}", files | {name: content}


def output(files: Files, random: np.random.Generator) -> str:
    """A name for the response; in `SLIPS` of all cases that of an input."""
    return str(random.choice(list(files))) if random.random() < SLIPS else OUT


def run(folder: Path, out: str) -> None:
    """Simulate in this process, which ends with it."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.chdir(folder)
    with open("stderr", "w") as errors, open("stdout", "w") as output:  # noqa: PTH123
        os.dup2(errors.fileno(), 2)
        os.dup2(output.fileno(), 1)
        sys.argv = ["thermojoint", "simulate", "case.toml", "--out", out]
        thermojoint()


def verdict(folder: Path, given: Files, code: int | None) -> str:
    """Return "result", "refused", or what is wrong."""
    if code is None:
        return f"hang: no end after {LIMIT_S:g} s"
    changed = [name for name, content in given.items() if (folder / name).read_bytes() != content]
    if changed:
        return f"input changed: {sorted(changed)}"
    said = (folder / "stderr").read_text(errors="replace")
    left = {path.name for path in folder.iterdir()} - {"stderr", "stdout", *given}
    if code == 0:
        with contextlib.suppress(Exception):
            read_response(folder / OUT)
            return "result" if left == {OUT} else f"files left: {sorted(left)}"
        return "exit code 0 without a response"
    if code != 2:
        last = said.strip().splitlines()[-1:] or [""]
        return f"exit code {code}: {last[0][:150]}"
    lines = [line for line in said.splitlines() if line and not line.startswith("warning: ")]
    if len(lines) != 1 or not lines[0].startswith("thermojoint: "):
        return f"not one line: {said[:300]!r}"
    return "refused" if not left else f"files left: {sorted(left)}"


def rows(outcomes: Counter[tuple[str, str]]) -> list[list[str]]:
    """Cells of the table, a row for each kind of damage and one for all."""
    kinds = ("result", "refused", "failed")
    made = [
        [damage, *(str(outcomes[damage, kind]) for kind in kinds)]
        for damage in sorted({damage for damage, _ in outcomes})
    ]
    sums = [str(sum(n for (_, found), n in outcomes.items() if found == kind)) for kind in kinds]
    return [*made, ["all", *sums]]


def page(counted: list[list[str]], count: int, seed: int) -> str:
    """The docs page."""
    table = [HEADER, ["---"] * len(HEADER), *counted]
    formats = ", ".join(suffix.removeprefix(".").upper() for suffix in WRITERS)
    return "\n".join(
        [
            "# Damaged inputs",
            "",
            f"Randomly damaged case files (TOML), histories (CSV) and meshes ({formats}), given to "
            "`thermojoint simulate`. Every input must produce either a complete response, or exit "
            "code 2, a one-line error message with at most warnings besides it on standard error, "
            "and no file left behind. A traceback, a hang, a partial file or a changed input file "
            f"is a failure; in {SLIPS:.0%} of the runs an input is also named as the output. Some "
            "damage leaves a valid input: a changed number, a lost line. Command:",
            "",
            "```sh",
            f"python -m benchmarks.fuzz --count {count} --seed {seed} --markdown "
            "docs/damaged-inputs.md",
            "```",
            "",
            *(f"| {' | '.join(cells)} |" for cells in table),
            "",
        ]
    )


def main() -> int:
    """Run the fuzz and print what came of it."""
    parser = options_of(__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"))
    parser.add_argument("--markdown", type=Path)
    asked = parser.parse_args()
    os.environ["THERMOJOINT_CACHE"] = "off"
    for module in LOADED:
        import_module(module)
    context = multiprocessing.get_context("fork")
    outcomes: Counter[tuple[str, str]] = Counter()
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        bases = unharmed(Path(name))
        running: dict[int, tuple[ForkProcess, float, Path, Files, str]] = {}

        def collect(block: bool) -> None:
            while True:
                for number, (process, begun, folder, files, kind) in list(running.items()):
                    late = time.monotonic() - begun > LIMIT_S
                    if process.is_alive() and not late:
                        continue
                    code = None if process.is_alive() else process.exitcode
                    process.kill()
                    process.join()
                    found = verdict(folder, files, code)
                    known = found in ("result", "refused")
                    outcomes[kind, found if known else "failed"] += 1
                    if not known:
                        failures.append(f"{number}: {kind}: {found}")
                        shutil.copytree(folder, asked.keep / str(number), dirs_exist_ok=True)
                    shutil.rmtree(folder)
                    del running[number]
                if len(running) < asked.workers and not (block and running):
                    return
                time.sleep(0.005)

        # No live display: its thread and its locks would not survive the fork.
        for number in range(asked.count):
            if number % 200 == 0:
                print(f"{number} of {asked.count}", file=sys.stderr, flush=True)
            random = np.random.default_rng([asked.seed, number])
            kind, files = mutated(*bases[int(random.integers(len(bases)))], random)
            folder = Path(name) / f"input-{number}"
            folder.mkdir()
            for file, content in files.items():
                (folder / file).write_bytes(content)
            process = context.Process(target=run, args=(folder, output(files, random)))
            process.start()
            running[number] = (process, time.monotonic(), folder, files, kind)
            collect(block=False)
        collect(block=True)

    counted = rows(outcomes)
    table = Table(*HEADER, title=f"seed {asked.seed}")
    for row in counted:
        table.add_row(*row)
    Console(width=100).print(table)
    if asked.markdown:
        write_text(asked.markdown, page(counted, asked.count, asked.seed))
    for failure in failures:
        print(failure)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
