"""Time integration of heat and contact on the condensed structure ("the march")."""
