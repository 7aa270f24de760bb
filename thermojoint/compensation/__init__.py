"""Compensation of an estimated displacement by axis offsets or heat."""
