"""What crosses the borders between packages: the response file, whole-or-nothing files, errors.

Every other package may import this one; it imports none of them.
"""
