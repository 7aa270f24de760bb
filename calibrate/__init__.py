"""Calibration of models from responses, simulated or measured."""
