"""Closed-loop compensation: a simulated machine, its estimator, a heater and axis offsets."""
