"""What a person sees of a command: help, progress, and as much of it as was asked for."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer

from thermojoint import console
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import COMMANDS, app
from thermojoint.cli.command import command_lines, help_text
from thermojoint.cli.main import BAD_INPUT, ENDING
from thermojoint.cli.simulating import OUT_OF_TOLERANCE
from thermojoint.paper import printing

NAMES = list(typer.main.get_command(app).commands)


@pytest.fixture(autouse=True)
def as_before():
    yield
    console.set_verbosity(console.Verbosity.NORMAL)


def run(*arguments, **variables):
    return subprocess.run(
        [sys.executable, "-m", "thermojoint", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"COLUMNS": "80"} | variables,
    )


def helped(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    app([name, "-h"], prog_name="thermojoint", standalone_mode=False)
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)


@pytest.mark.parametrize("name", NAMES)
def test_a_command_in_the_help_can_be_copied_from_80_columns(name, monkeypatch, capsys):
    page = helped(name, monkeypatch, capsys)
    lines = [line.strip() for line in page.splitlines()]
    assert max(map(len, page.splitlines())) <= 80
    examples = [k + 1 for k, line in enumerate(lines) if line == "Example:"]
    assert examples
    for begin in examples:
        copied = ""
        for line in lines[begin:]:
            copied += line.removesuffix("\\")
            if not line.endswith("\\"):
                break
        assert f"thermojoint {name}" in copied
        command = next(one for group in COMMANDS.values() for one in group if _name(one) == name)
        assert copied in " ".join(command.__doc__.replace("[/bold]", "").split())


def _name(command):
    return command.__name__.replace("_", "-")


def test_a_long_command_is_continued_before_an_option():
    found = command_lines("thermojoint learn log.csv --out model.json --kind ridge", 42)
    assert found == ["thermojoint learn log.csv --out model.json \\\\", "  --kind ridge"]
    assert command_lines("thermojoint verify", 40) == ["thermojoint verify"]


def test_a_paragraph_of_help_is_wrapped_by_the_terminal():
    assert help_text("One\n    line.\n\n    Two\n    lines.") == "One line.\n\nTwo lines."


def test_the_commands_are_grouped(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        app(["-h"], prog_name="thermojoint")
    page = capsys.readouterr().out
    places = [page.index(f"─ {panel} ─") for panel in COMMANDS]
    assert places == sorted(places)


@pytest.mark.parametrize("name", [_name(one) for panel in COMMANDS.values() for one in panel])
def test_help_breaks_no_choice_and_no_line_at_80_columns(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        app([name, "-h"], prog_name="thermojoint")
    page = capsys.readouterr().out.splitlines()
    assert max(map(len, page)) <= 80
    # A list of choices in angle brackets that goes on in the next line is broken in mid-word.
    assert not [line for line in page if re.search(r"<[\w-]+\|[^>]*$", line)]


def test_a_shell_completes_commands():
    found = run(
        _THERMOJOINT_COMPLETE="complete_bash",
        COMP_WORDS="thermojoint sim",
        COMP_CWORD="1",
        _TYPER_COMPLETE_ARGS="thermojoint sim",
    )
    assert found.stdout.split() == ["simulate"]


def test_progress_without_a_terminal_is_a_line_now_and_then(capsys):
    with console.progress_lines(first_s=0.01, every_s=0.01) as report:
        report("marching", 3, 7)
        report("set up", 1, 1)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert set(lines) == {"marching: 3 of 7, 0 s"}


def test_what_is_quick_says_nothing(capsys):
    with console.working("reading"):
        pass
    assert capsys.readouterr().err == ""


def test_quiet_leaves_warnings_and_errors(capsys):
    console.set_verbosity(console.verbosity(quiet=True, verbose=False))
    with console.working("reading"):
        console.say("read")
        console.out().print("a table")
        console.warn(["implausible"])
    assert capsys.readouterr() == ("", "warning: implausible\n")


def test_verbose_says_how_long_a_part_took(capsys):
    console.set_verbosity(console.verbosity(quiet=False, verbose=True))
    with console.working("reading"):
        pass
    assert re.fullmatch(r"reading: \d+\.\d s\n", capsys.readouterr().err)


def test_quiet_and_verbose_at_once_are_refused():
    with pytest.raises(InputError, match="give one of them"):
        console.verbosity(quiet=True, verbose=True)


@pytest.mark.parametrize("name", NAMES)
def test_every_command_can_be_quiet_and_verbose(name, monkeypatch, capsys):
    page = helped(name, monkeypatch, capsys)
    assert re.search(r"--quiet +-q", page)
    assert re.search(r"--verbose +-v", page)


def test_the_page_lists_every_exit_code():
    page = (Path(__file__).parents[2] / "docs" / "files.md").read_text("utf-8")
    table = page.split("## Exit codes")[1].split("##")[0]
    codes = {0, OUT_OF_TOLERANCE, BAD_INPUT, *(128 + number for number in ENDING)}
    assert codes == {
        int(one) for row in re.findall(r"^\| ([\d, ]+) \|", table, re.M) for one in row.split(",")
    }


def test_no_column_of_a_validation_stands_twice():
    headings = [heading for heading, *_ in printing._ERRORS]
    assert len({*headings}) == len(headings)
