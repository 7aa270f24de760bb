"""Quality of a value, from the estimator's status and its age."""

from __future__ import annotations

from collections.abc import Sequence

from estimator.interface import SILENT
from estimator.quality import Quality

#: Status of a sample that the estimator refused.
REFUSED = "refused"


def quality_at(age: float, uncertain: float, bad: float) -> Quality:
    """Return the best possible quality at an age, by those from which it is uncertain or bad, s."""
    if age >= bad:
        return Quality.BAD
    return Quality.UNCERTAIN if age >= uncertain else Quality.GOOD


def silent_status(status: str, quality: Quality) -> str:
    """Return a status in words, with `SILENT` added unless the quality is good."""
    words: Sequence[str] = [word for word in status.split() if word not in (SILENT, "ok")]
    if quality is not Quality.GOOD:
        words = [*words, SILENT]
    return " ".join(words) or "ok"
