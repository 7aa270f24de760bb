"""The joint: its law (Eq. 11, pressure, friction), its operators, and its equilibrium."""
