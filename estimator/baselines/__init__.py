"""Baseline estimators: no compensation, the linear model, regressions."""
