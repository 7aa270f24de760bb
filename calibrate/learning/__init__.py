"""From a machine's log to a learned model: cleaning, blocks of time, selection, fit."""
