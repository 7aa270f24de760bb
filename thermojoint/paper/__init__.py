"""Reproduction of the paper: inputs, calibration chain with files, tables, figures and report."""
