"""Estimator of a learned model, with occasional readings of the displacement."""
