"""The march: heat and contact stepped in time on the condensed structure."""
