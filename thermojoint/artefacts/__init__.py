"""Files and errors shared by all packages: responses, tables, atomic writing.

Every other package may import this one; it imports none of them.
"""
