"""Learning of a model from a machine's log: cleaning, cross-validation, selection, fit."""
