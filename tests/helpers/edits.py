"""Nested dictionaries with other values in some places."""

import copy


def edited(data, *edits):
    """A copy with edits ((key, ..., key), value); missing sections are made, None deletes a key."""
    data = copy.deepcopy(data)
    for place, value in edits:
        part = data
        for key in place[:-1]:
            part = part.setdefault(key, {})
        if value is None:
            del part[place[-1]]
        else:
            part[place[-1]] = value
    return data
