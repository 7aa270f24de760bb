"""Calibration of a joint-aware model from responses: physics, filter, confidence band."""
