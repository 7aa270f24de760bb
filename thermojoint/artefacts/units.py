"""Factors of metric prefixes, for values that a person reads or writes."""

#: Micrometres to metres.
MICRO = 1e-6
#: Megapascals to pascals; metres to micrometres.
MEGA = 1e6
