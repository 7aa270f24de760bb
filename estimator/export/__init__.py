"""Export of estimators as self-contained programs for controls."""
