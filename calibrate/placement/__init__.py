"""Sensor placement."""
