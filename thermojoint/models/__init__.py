"""The generalised models: their equations, parameters, files, and the filters made of them."""
