"""Service beside the control: readings in, estimated displacement out, continuously."""
