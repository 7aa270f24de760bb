"""Factors of metric prefixes, for values that a person reads or writes."""

#: Millimetres to metres; micrometres to metres.
MILLI = 1e-3
MICRO = 1e-6
#: Megapascals to pascals; metres to micrometres.
MEGA = 1e6
