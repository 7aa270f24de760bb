"""Verification: cases whose results are known, run through the simulator's own operators."""
