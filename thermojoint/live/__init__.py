"""The service beside the control: readings in, displacement out, as long as the machine stands."""
