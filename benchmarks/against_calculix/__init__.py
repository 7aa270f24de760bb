"""The same cases by CalculiX: decks, runs, results, comparison (docs/against-calculix.md)."""
