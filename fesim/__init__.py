"""The simulator: a 3-D thermoelastic structure whose only nonlinearity is its joints."""
