"""Sources of a table's lines: text in any common encoding, Excel workbooks, Parquet."""

from __future__ import annotations

import codecs
import csv
import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, time
from pathlib import Path
from typing import BinaryIO

from thermojoint.artefacts.errors import InputError, UnreadableError
from thermojoint.artefacts.extras import require

#: Number of bytes from which the format of a file is detected.
_HEAD = 4096
#: First bytes of a workbook (.xlsx is a zip), of Parquet, and of a workbook before 2007.
_ZIP, _PARQUET, _OLD_EXCEL = b"PK\x03\x04", b"PAR1", b"\xd0\xcf\x11\xe0"


def _as_cp1252(error: UnicodeError) -> tuple[str, int]:
    """Decode bytes that are not UTF-8 as CP1252, in which a degree sign is one byte."""
    if not isinstance(error, UnicodeDecodeError):
        raise error
    wrong = error.object[error.start : error.end]
    return "".join(
        chr(byte) if byte in _NOT_IN_CP1252 else _cp1252(byte) for byte in wrong
    ), error.end


def _cp1252(byte: int) -> str:
    return bytes([byte]).decode("cp1252")


_NOT_IN_CP1252 = {0x81, 0x8D, 0x8F, 0x90, 0x9D}
#: Name of the error handler for UTF-8 that decodes invalid bytes as CP1252.
OR_CP1252 = "thermojoint-or-cp1252"
codecs.register_error(OR_CP1252, _as_cp1252)


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes; `OR_CP1252` decodes invalid UTF-8."""
    if head[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    # Without a byte order mark: in Latin letters and digits one byte of two is zero.
    if len(head) >= 4 and head[1:2] == head[3:4] == b"\0":
        return "utf-16-le"
    if len(head) >= 4 and head[0:1] == head[2:3] == b"\0":
        return "utf-16-be"
    return "utf-8-sig"


def as_text(file: BinaryIO, head: bytes) -> io.TextIOWrapper:
    """Return an open file as text."""
    return io.TextIOWrapper(file, encoding_of(head), errors=OR_CP1252, newline=None)


@contextmanager
def lines_of(path: Path, kind: str) -> Iterator[Iterable[str]]:
    """Open a table and give its lines; .xlsx and Parquet, known by content, become lines of CSV.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        It is not a table, or the library that reads it is not installed.
    """
    if not path.is_file():
        raise UnreadableError(f"{path}: no such file; give a {kind} as CSV, .xlsx or Parquet")
    try:
        file = path.open("rb")
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read; check its permissions") from error
    with file:
        head = file.read(_HEAD)
        file.seek(0)
        if head.startswith(_ZIP):
            yield _sheet_lines(file, str(path))
        elif head.startswith(_PARQUET):
            yield _parquet_lines(file, str(path))
        elif head.startswith(_OLD_EXCEL):
            raise InputError(f"{path}: a workbook from before 2007; save it as .xlsx or CSV")
        elif b"\0" in head and encoding_of(head) == "utf-8-sig":
            raise InputError(f"{path}: no table; give a CSV, .xlsx or Parquet")
        else:
            with as_text(file, head) as text:
                yield _text_lines(text, str(path))


def _text_lines(text: io.TextIOWrapper, where: str) -> Iterator[str]:
    try:
        yield from text
    except UnicodeError as error:
        raise InputError(f"{where}: text in an unknown encoding; save it as UTF-8") from error
    except OSError as error:
        raise UnreadableError(f"{where}: cannot be read ({error.strerror})") from error


def _sheet_lines(file: BinaryIO, where: str) -> Iterator[str]:
    """Yield the first sheet with two rows or more as lines of CSV."""
    require(f"{where}: .xlsx", "excel", "openpyxl")
    import openpyxl

    try:
        book = openpyxl.load_workbook(file, read_only=True, data_only=True)
        sheet = next((sheet for sheet in book.worksheets if (sheet.max_row or 2) > 1), None)
        for row in sheet.iter_rows(values_only=True) if sheet else ():
            yield _line(row)
    except (OSError, KeyError, ValueError, TypeError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: no readable workbook ({error}); save it as CSV") from error


def _parquet_lines(file: BinaryIO, where: str) -> Iterator[str]:
    require(f"{where}: Parquet", "batch", "pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(file)
        yield _line(table.schema_arrow.names)
        for batch in table.iter_batches():
            columns = [
                # Logs have no finer resolution than a microsecond.
                column.cast(pa.timestamp("us", column.type.tz), safe=False)
                if pa.types.is_timestamp(column.type)
                else column
                for column in batch.columns
            ]
            for row in zip(*(column.to_pylist() for column in columns), strict=True):
                yield _line(row)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{where}: no readable Parquet ({error}); save it as CSV") from error


def _line(cells: Iterable[object]) -> str:
    """Return cells as a line of CSV that is read back as exactly the same numbers."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(map(_text, cells))
    return line.getvalue()


def _text(cell: object) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime):
        # A date without a time of day is its midnight: a column of times may be beside it.
        midnight = cell.tzinfo is None and cell.time() == time.min
        return cell.date().isoformat() if midnight else cell.isoformat(sep=" ")
    return str(cell)
