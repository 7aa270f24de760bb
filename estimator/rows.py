"""One line of a table of errors: what was judged, and figures; None where one is not known."""

from __future__ import annotations

from collections.abc import Mapping

#: E.g. case, estimator, axis, max_abs_error_um.
Row = Mapping[str, str | float | None]
