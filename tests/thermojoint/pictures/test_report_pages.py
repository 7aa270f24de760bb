"""Reports are readable on a narrow page."""

import browser
import numpy as np
import pytest
from matplotlib.text import Text

from estimator.fchs.judging import ESTIMATORS
from thermojoint.paper import inputs
from thermojoint.paper.report import Picture, ReportData, report_html
from thermojoint.paper.summary import convergence
from thermojoint.pictures import figures
from thermojoint.standards.iso230_3 import report as iso230_3
from thermojoint.standards.iso230_3.evaluation import evaluate, with_uncertainties
from thermojoint.standards.iso230_3.figure import figure_of
from thermojoint.standards.iso230_3.instruments import Instruments
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import Record


@pytest.fixture(scope="module")
def warm_up():
    times = np.arange(0.0, 4.0 * 3600.0, 60.0)
    channels = {f"spindle nose {k}": 1e-6 * k * np.sqrt(times) for k in range(1, 5)}
    record = Record(times, channels, {"bearing": 20.0 + 1e-3 * times})
    return record, with_uncertainties(evaluate(Protocol.ETVE, record), record, Instruments())


def test_the_text_of_figures_is_9_pixels_high_where_they_are_360_wide(coarse_response, warm_up):
    times, errors = np.arange(5.0), {name: np.zeros((5, 2)) for name in ESTIMATORS}
    drawn = [
        figures.response_figure(coarse_response),
        figures.pressure_figure(coarse_response),
        figures.estimates_figure(times, errors, ["x", "y"], "day"),
        figures.panels_figure(times, {"x": {"actual": times}}, "heat", *figures.NONLINEAR),
        figure_of(*warm_up),
    ]
    for figure in drawn:
        sizes = [one.get_fontsize() for one in figure.findobj(Text) if one.get_text()]
        assert min(sizes) * 360.0 / (72.0 * figure.get_figwidth()) >= 9.0


@pytest.mark.long
@browser.needs_chromium
def test_reports_are_not_scrolled_sideways_on_a_page_of_400_pixels(
    tmp_path, coarse_response, warm_up
):
    figures.write_figure(figures.response_figure(coarse_response), tmp_path / "curves.png")
    rows = [
        {"case": case, "axis": axis, "estimator": name, "max_abs_error_um": 12.3456,
         "rms_error_um": 1.0, "peak_total_um": 200.0, "peak_nonlinear_um": 20.0}
        for case in inputs.CASES for axis in "xy" for name in ESTIMATORS
    ]  # fmt: skip
    data = ReportData(
        title="A machine",
        facts=[("versions", "numpy 2.4.6, scipy 1.17.1")],
        validation=rows,
        convergence={"step-2.0": convergence(coarse_response)},
        placement="a = s550_610_100 " * 9,
        pictures=[Picture(tmp_path / "curves.png", "Overview")],
    )
    thermal_test = iso230_3.report_html(*warm_up, "log.csv")
    browser.assert_readable_at_400_px(report_html(data), thermal_test)
