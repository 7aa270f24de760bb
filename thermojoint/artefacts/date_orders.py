"""Orders in which a date can be written: day, month or year first."""

from __future__ import annotations

from collections.abc import Mapping

_DAY = 86_400.0
#: A longer step, s, is none between two days of a log if another order of the date makes it short.
WEEK = 7.0 * _DAY
#: Order of a date to its description.
ORDERS = {"dmy": "day before month", "mdy": "month before day", "ymd": "year before month"}


def two_orders(one: tuple[str, float], other: tuple[str, float]) -> str:
    """Return the end of a refusal: two orders of dates, and the time, s, that passes by each."""
    (order, step), (other_order, other_step) = one, other
    return (
        f"pass {step / _DAY:.4g} d if the dates are read {ORDERS[order]}, {other_step / _DAY:.2g} d"
        f" if {ORDERS[other_order]}; write them year first with four digits, like 2026-03-02"
    )


def shorter_order(
    step: float, before: Mapping[str, float], after: Mapping[str, float]
) -> tuple[str, float]:
    """Return another order of dates that makes a step of weeks, or back, a short one, and that.

    Parameters
    ----------
    step : float
        Time from one row to another, s.
    before, after : mapping
        Their times by other orders (`thermojoint.artefacts.tables.clock.by_other_orders`).

    Returns
    -------
    order : str
        Empty if there is none.
    step : float
        By that order, s.
    """
    if 0.0 < step <= WEEK:
        return "", step
    # Files sorted by wrong dates may come in the other order.
    least = -WEEK if step > WEEK else 0.0
    others = {order: after[order] - before[order] for order in after if order in before}
    near = ((order, other) for order, other in others.items() if least < other <= WEEK)
    return next(near, ("", step))
