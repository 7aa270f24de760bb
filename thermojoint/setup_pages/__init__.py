"""Setting up in the browser: from a log or a CAD part to settings, results and a running service.

The pages run the program's own commands in a folder and write the files that a person would; what
they show is what these files say.
"""
