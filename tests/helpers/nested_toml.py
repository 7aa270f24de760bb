"""Nested dictionaries as TOML."""


def as_toml(data):
    """A line for each key, its tables inline."""
    return "".join(f"{key} = {_inline(value)}\n" for key, value in data.items())


def _inline(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{key}" = {_inline(one)}' for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)
