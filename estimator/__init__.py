"""Estimates heat and displacement from temperatures alone, sample by sample (Figure 5)."""
