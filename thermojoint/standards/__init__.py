"""Tests of machine tools that a standard describes: what a record of one says, in its terms."""
