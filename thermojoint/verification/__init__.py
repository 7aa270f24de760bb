"""Verification: cases with known results, computed with the simulator's own operators."""
