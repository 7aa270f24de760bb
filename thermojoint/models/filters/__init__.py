"""Models as filters: banks of exponential states, rational approximation, inverses (Eqs. 3-6)."""
