"""Sensitivity of a simulated machine to the values of its case: derivatives, screening, Sobol."""
