"""The bodies: finite-element operators of heat and elasticity, condensed on the joints."""
