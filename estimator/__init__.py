"""Estimate displacement from temperatures, sample by sample: every kind behind one interface."""
