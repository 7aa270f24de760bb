"""The command `iso230-3`: thermal tests."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds
from thermojoint.cli.log_reading import ColumnOption, MappingOption, renamed_by, say, spikes_in
from thermojoint.standards.iso230_3.protocol import Protocol

if TYPE_CHECKING:
    from thermojoint.artefacts.log import Log
    from thermojoint.artefacts.log_record import Record as LogRecord
    from thermojoint.standards.iso230_3.record import Record


Named = TypeVar("Named")


def iso230_3(  # noqa: PLR0913 - the options of a command
    given: Annotated[
        Path, typer.Argument(metavar="RECORD", help="Log of the test (CSV), or a response (.nc).")
    ],
    test: Annotated[
        Protocol,
        typer.Option(
            metavar="TEST",
            help=f"The recorded test: {', '.join(protocol.value for protocol in Protocol)}.",
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Report to write (HTML).")] = None,
    parameters: arguments.Json = None,
    displacement: Annotated[
        list[str] | None,
        typer.Option(help="Column or axis to evaluate, also NAME=COLUMN; default: all."),
    ] = None,
    temperature: Annotated[
        list[str] | None,
        typer.Option(help="Column or probe; default: all of a log, the first six of a response."),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(help="Column of a log that is 0 at standstill; default: the one in rpm."),
    ] = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
    second: Annotated[
        Path | None,
        typer.Option(help="The same run at a second point; its channels get the suffix 2."),
    ] = None,
    tilt: Annotated[
        list[str] | None,
        typer.Option(help="NAME=FIRST,SECOND: (first - second) / distance, e.g. B=X1,X2."),
    ] = None,
    distance: Annotated[
        float | None, typer.Option("--distance-mm", help="Between the points of every tilt.")
    ] = None,
    instruments: Annotated[
        Path | None,
        typer.Option(
            help="What is known of the instruments (TOML), for the uncertainty; default: "
            "assumptions for a log, no uncertainty for a response."
        ),
    ] = None,
    begin: Annotated[
        float | None, typer.Option("--begin-min", help="Start of the running period in the record.")
    ] = None,
    end: Annotated[float | None, typer.Option("--end-min", help="Its end.")] = None,
) -> None:
    """Evaluate a thermal test after ISO 230-3: environment, spindle, linear or rotary axis.

    Example: [bold]thermojoint iso230-3 warm_up.csv --test spindle --displacement X1=disp1_um
    --displacement X2=disp3_um --tilt B=X1,X2 --distance-mm 150 --out report.html[/bold]

    Example: [bold]thermojoint iso230-3 etve.nc --test etve --out etve.html --json
    etve.json[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.cli import results
    from thermojoint.standards.iso230_3 import record as records
    from thermojoint.standards.iso230_3 import report
    from thermojoint.standards.iso230_3.evaluation import evaluate, with_uncertainties
    from thermojoint.standards.iso230_3.instruments import Instruments, read_instruments
    from thermojoint.standards.iso230_3.period import longest_unread, runs_at_first

    arguments.check_outputs(
        {
            "--out": (out, file_kinds.TEST_REPORT),
            "--json": (parameters, file_kinds.TEST_PARAMETERS),
        },
        [given, second, mapping, instruments],
    )
    pairs = _each_once("--tilt", map(_pair, tilt or []))
    if bool(pairs) != (distance is not None):
        raise InputError("--tilt and --distance-mm: give both or neither")
    known = None if given.suffix == ".nc" else Instruments()
    if instruments is not None:
        known = read_instruments(instruments)
    renamed = renamed_by(column, mapping)
    channels = _each_once("--displacement", map(_channel, displacement or [])) or None
    with console.working("reading"):
        record, read, misread = _record(given, renamed, channels, temperature, speed)
    facts = []
    if second is not None:
        beside, more, wrong = _record(second, renamed, channels, temperature, speed)
        read, misread = read + more, misread + wrong
        record = records.with_second(record, beside)
        facts.append(("second point", second.name))
    if distance is not None:
        record = records.with_tilts(record, pairs, 1e-3 * distance)
        facts += [
            (f"tilt {name}", f"({first} - {second}) / l") for name, (first, second) in pairs.items()
        ]
        facts.append(("distance l", f"{distance:g} mm"))
    ends = [None if minutes is None else 60.0 * minutes for minutes in (begin, end)]
    evaluation = evaluate(test, record, *ends)
    if known is not None:
        evaluation = with_uncertainties(evaluation, record, known)
    if out:
        write_text(out, report.report_html(record, evaluation, given.name, facts))
    content = report.parameters_json(evaluation, given.name)
    arguments.write_json(parameters, content)
    say(read)
    console.warn(misread)
    period, running = evaluation.period, test is not Protocol.ETVE
    if read and begin is None and running and runs_at_first(record, period):
        paused = f" after a pause, at {period.begin / 60.0:.4g} min" if period.begin else ""
        console.warn(
            [
                f"{given}: the machine already runs in the first reading{paused}, so growth before "
                "it is missing from the parameters; start the record earlier, or give --begin-min "
                "if the run begins there"
            ]
        )
    if read:
        console.warn(
            [
                f"{given}: {', '.join(names)}: not read from {gap.begin / 60.0:.4g} to "
                f"{gap.end / 60.0:.4g} min of the record; an extreme in between is missing from "
                "the parameters; repeat the test, or leave the channel out"
                for gap, names in longest_unread(record, period).items()
            ]
        )
    results.show_test(console.out(parameters), test.heading, content)
    console.wrote(out, parameters)


def _record(
    path: Path,
    renamed: dict[str, str],
    channels: dict[str, str] | None,
    temperatures: list[str] | None,
    speed: str | None,
) -> tuple[Record, tuple[LogRecord, ...], list[str]]:
    """Return the record of a test, the report on its log, and warnings of misread values in it."""
    from thermojoint.standards.iso230_3.record import log_record, response_record

    if path.suffix == ".nc":
        from thermojoint.artefacts.response import read_response

        if renamed or speed:
            raise InputError(
                f"{path}: --column, --mapping and --speed go with a log; leave them out"
            )
        return response_record(read_response(path), channels, temperatures), (), []
    from thermojoint.artefacts.log_file import read_log

    log = read_log([path], renamed)
    record = log_record(log, channels, temperatures, speed)
    return record, log.records, _misread(path, log, channels, temperatures)


def _misread(
    path: Path, log: Log, channels: dict[str, str] | None, temperatures: list[str] | None
) -> list[str]:
    """Return a warning about each evaluated column that has spikes."""
    moved = [one.name for one in log.columns if one.is_displacement]
    evaluated = [*(moved if channels is None else channels.values())]
    evaluated += log.of("temperature") if temperatures is None else temperatures
    names = {log.columns[log.index(name)].name for name in evaluated}
    return [
        f"{path}: {column}: {count} spikes, as of misread values; the parameters contain them; "
        "empty these cells"
        for column, count in spikes_in(log, names).items()
    ]


def _each_once(option: str, given: Iterable[tuple[str, Named]]) -> dict[str, Named]:
    """Return the given values by name; refuse a name that is given twice."""
    found: dict[str, Named] = {}
    for name, value in given:
        if name in found:
            raise InputError(f"{option} {name}: is given twice; give each its own name")
        found[name] = value
    return found


def _named(option: str, text: str) -> tuple[str, str]:
    first, _, second = text.partition("=")
    if not first or not second:
        raise InputError(f"{option} {text}: write it with an equals sign between two names")
    return first, second


def _channel(text: str) -> tuple[str, str]:
    return _named("--displacement", text) if "=" in text else (text, text)


def _pair(text: str) -> tuple[str, tuple[str, str]]:
    name, both = _named("--tilt", text)
    first, _, second = both.partition(",")
    if not first or not second:
        raise InputError(f"--tilt {text}: write NAME=FIRST,SECOND, two displacement channels")
    return name, (first.strip(), second.strip())
