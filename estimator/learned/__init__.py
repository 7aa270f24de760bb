"""Estimator of a learned model, with occasional displacement readings."""
