"""Files of one log, one after the other: their clocks fit each other, and no hours count twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.date_orders import ORDERS, shorter_order, two_orders
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_record import Record, moment_text, moved, with_times

#: Rows by which the beginning of a file is found in another one, and fewest that are enough.
HEAD, _FEWEST = 64, 10


def following(before: Log | None, pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a file after the last piece of the file before it, if there is one.

    Raises
    ------
    InputError
        The clocks of the files do not fit each other, or both have the same hours.
    """
    for k, given in enumerate(pieces):
        piece = given.with_order(before.columns) if before else given
        (record,) = piece.records
        if before and not k:
            check_dates(record, before.records[0])
            check_zones(record, before.records[0])
            check_orders(record, before.records[0])
            check_follows(record, before.records[0])
        if before is None or not record.dated:
            yield piece
            continue
        shift = before.records[0].shift
        later = replace(piece, times=piece.times + shift, records=(moved(record, shift),))
        if k or later.times[0] > before.times[-1]:
            yield later
        else:
            yield from _without_repeated(before, later)


def _without_repeated(before: Log, piece: Log) -> Iterator[Log]:
    """Yield the first piece of a file without its first row, which ended the file before it.

    Raises
    ------
    InputError
        It begins with another row, so that the hours of both files would count twice.
    """
    (record,), (other,) = piece.records, before.records
    same = np.array_equal(piece.values[0], before.values[-1], equal_nan=True)
    if piece.times[0] != before.times[-1] or not same:
        begin, end = (moment_text(record, time) for time in (record.first, other.last))
        raise InputError(
            f"{record.where}: begins at {begin}, before {other.where} ends at {end}; the same "
            "hours would count twice: leave one file out, or drop the rows that are in both"
        )
    if len(piece.times) > 1:
        times = piece.times[1:]
        record = with_times(replace(record, twice=record.twice + 1), times, -np.inf)
        yield replace(piece.part(slice(1, None)), records=(record,))


def check_zones(record: Record, other: Record) -> None:
    """Refuse two clocks with dates of which only one has a time zone: hours may lie between them.

    Raises
    ------
    InputError
        One of them shows a local time, the other does not.
    """
    if record.dated and other.dated and record.local != other.local:
        one, another = (record, other) if record.local else (other, record)
        raise InputError(
            f"{one.where}: its clock has no time zone, that of {another.where} has; put it in "
            "brackets behind the clock's name, like time [Europe/Berlin] or time [UTC]"
        )


def check_dates(record: Record, other: Record) -> None:
    """Refuse two files of one log of which only one has dates: nothing tells what lies between.

    Raises
    ------
    InputError
        The clock of one of them counts from its own start.
    """
    if record.dated != other.dated:
        one, another = (other, record) if record.dated else (record, other)
        raise InputError(
            f"{one.where}: its clock has no date, that of {another.where} has; give every file of "
            "a log the same clock"
        )


def common_order(orders: Iterable[Sequence[str]]) -> str:
    """Return the first order of a file's dates that fits those of all files; empty without one."""
    several = [own for own in orders if own]
    return next((own[0] for own in several if all(own[0] in other for other in several)), "")


def check_orders(record: Record, other: Record) -> None:
    """Refuse two clocks whose dates are read in two orders.

    Raises
    ------
    InputError
        Each fits its own dates.
    """
    if record.order and other.order and record.order != other.order:
        raise InputError(
            f"{record.where}: its dates are read {ORDERS[record.order]}, those of {other.where} "
            f"{ORDERS[other.order]}; write them year first with four digits, like 2026-03-02"
        )


def check_follows(record: Record, before: Record) -> None:
    """Refuse a file that follows another after weeks, but soon by another order of the dates.

    Parameters
    ----------
    record, before : Record
        For a file, and for the file before it in the order of time.

    Raises
    ------
    InputError
        With what to write.
    """
    step = record.first - before.last
    ends = {order: last for order, (_, last) in before.by_other_orders.items()}
    begins = {order: first for order, (first, _) in record.by_other_orders.items()}
    order, other = shorter_order(step, ends, begins)
    if order:
        both = two_orders((record.order, step), (order, other))
        raise InputError(f"{record.where}: since {before.where} {both}")


def shared(piece: Log, log: Log) -> tuple[int, int]:
    """Return how many times of a log are in a piece, and how many with the same readings."""
    own = log.with_order(piece.columns)
    if own.columns != piece.columns:
        return 0, 0
    at = np.minimum(np.searchsorted(piece.times, own.times), len(piece.times) - 1)
    there = piece.times[at] == own.times
    same = _same_rows(piece.values[at], own.values)
    return int(np.count_nonzero(there)), int(np.count_nonzero(there & same))


def telling(head: Log | None) -> Log | None:
    """Return the first rows of a file if no other run begins with the same ones by chance."""
    if head is None or head.records[0].dated or len(head.times) < _FEWEST:
        return None
    return None if _same_rows(head.values[1:], head.values[:-1]).all() else head


def _same_rows(rows: Array, others: Array) -> Flags:
    same = (rows == others) | (np.isnan(rows) & np.isnan(others))
    return np.asarray(same.all(axis=1))
