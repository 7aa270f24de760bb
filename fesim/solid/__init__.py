"""Finite-element operators of heat conduction and elasticity, condensed on the joints."""
