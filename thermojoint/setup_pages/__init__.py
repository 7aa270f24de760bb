"""Set-up in the browser: from a log or a CAD part to settings, results and a running service.

The pages run the program's own commands in a folder and write the same files as a person would;
they display the content of these files.
"""
