"""Order of the inputs of a structure: sources, then the ambient, then held surfaces."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InputLayout:
    """Indices of the inputs."""

    #: Number of heat sources, W each.
    sources: int
    #: Number of surfaces with prescribed temperature, K each.
    held: int

    @property
    def count(self) -> int:
        """Number of inputs."""
        return self.ambient + 1 + self.held

    @property
    def source_columns(self) -> slice:
        """The sources, in the order of the case."""
        return slice(0, self.sources)

    @property
    def ambient(self) -> int:
        """The ambient above its initial temperature, K."""
        return self.sources

    @property
    def held_columns(self) -> slice:
        """The held surfaces, in the order of the case."""
        return slice(self.ambient + 1, self.count)

    @property
    def temperature_columns(self) -> slice:
        """All inputs that are temperatures, K: the ambient and the held surfaces."""
        return slice(self.ambient, self.count)
