"""Evaluation of machine-tool tests by standards."""
