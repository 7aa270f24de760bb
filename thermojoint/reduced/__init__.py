"""Reduced-order model of a machine: its modes, its joints, their parameters, a step in time."""
