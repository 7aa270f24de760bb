"""Estimators of displacement from temperatures, sample by sample, with one interface."""
