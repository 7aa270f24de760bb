"""Report of a closed loop: one self-contained HTML page, and the same figures as JSON."""

from __future__ import annotations

from typing import Any

from estimator.joint_aware.model_file import read_observer
from thermojoint.artefacts.figures import svg_address
from thermojoint.artefacts.templates import templates_of
from thermojoint.compensation.loop.figure import bode_figure, runs_figure, step_figure
from thermojoint.compensation.loop.run import Closed


def report_html(closed: Closed, content: dict[str, Any]) -> str:
    """Return the page of `judging.as_content`, escaped, without references to other files."""
    environment = templates_of("thermojoint.compensation.loop")
    figures = [("The runs against time", runs_figure(closed))]
    if closed.design is not None:
        model = read_observer(closed.loop.estimator.model)
        figures += [
            ("Bode diagram", bode_figure(closed.design, closed.loop.estimator.delay_s)),
            ("Step responses near the preload", step_figure(model, closed)),
        ]
    pictures = [(title, svg_address(figure, "control")) for title, figure in figures]
    return environment.get_template("report.html.j2").render(
        title=f"{content['title']}: closed loop",
        generator="control",
        content=content,
        loop=closed.loop,
        pictures=pictures,
    )
