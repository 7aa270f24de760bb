"""An estimator as the source of a program for a control: C99 that needs nothing but its files."""
