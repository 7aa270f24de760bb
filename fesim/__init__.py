"""Simulator of 3-D thermoelastic structures with nonlinear joints."""
