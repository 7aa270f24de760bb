"""Factors of metric prefixes, for values that a person reads or writes."""

#: Metres of a micrometre: times a length in µm it is one in m.
MICRO = 1e-6
#: Pascals of a megapascal, micrometres of a metre: times a length in m it is one in µm.
MEGA = 1e6
