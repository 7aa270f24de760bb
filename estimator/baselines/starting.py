"""The regressions that a file of baselines holds, as estimators."""

from __future__ import annotations

from estimator.baselines.autoregression import AutoregressionEstimator
from estimator.baselines.regression import RegressionEstimator
from estimator.interface import Estimator
from thermojoint.models.baselines import Baselines


def regressions(baselines: Baselines, dt_s: float) -> list[Estimator]:
    """Return the estimators mlr, ridge and arx.

    Parameters
    ----------
    baselines : Baselines
    dt_s : float
        Nominal sampling interval, s: how long before the first sample the machine is at rest.
    """
    return [
        RegressionEstimator("mlr", baselines.mlr, baselines.span, dt_s),
        RegressionEstimator("ridge", baselines.ridge, baselines.span, dt_s),
        AutoregressionEstimator(baselines.arx, baselines.interval_s, baselines.span),
    ]
