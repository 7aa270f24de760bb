"""Fits the generalised models to responses, simulated or measured; knows no finite elements."""
