"""The generalised models: equations, parameters, files, and filters."""
