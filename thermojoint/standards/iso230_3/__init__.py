"""ISO 230-3, thermal effects: environment, rotating spindle, moving linear and rotary axes."""
