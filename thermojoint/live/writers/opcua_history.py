"""History of the service's own values by OPC UA (HistoryRead of raw values), from its archive."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from datetime import UTC, datetime

from asyncua import ua
from asyncua.server.history import HistoryStorageInterface

from thermojoint.live.archive import MOST_ROWS, Archive
from thermojoint.live.opcua_values import Variable, data_value
from thermojoint.live.times import since_1970

#: Number of values of one variable in a response; others follow by continuation points.
_MOST = 5_000
_MICROSECOND = 1e-6
#: OPC UA represents a missing time by its first day.
_FIRST_YEAR = 1602


class ArchiveHistory(HistoryStorageInterface):
    """Reads the archive, given machine and variable of each node; OPC UA never writes to it."""

    def __init__(
        self, archive: Archive, variables: Mapping[ua.NodeId, tuple[str, Variable]]
    ) -> None:
        super().__init__(_MOST)
        self.archive, self.variables = archive, variables

    async def init(self) -> None:
        """Do nothing: no initialisation is needed."""

    async def stop(self) -> None:
        """Do nothing: no resource is held."""

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """Return values between two times, and the time of the next one if there are more.

        Without a start, or with one after the end, the newest come first.
        """
        if node_id not in self.variables:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadHistoryOperationUnsupported)
        since, until = _seconds(start, -math.inf), _seconds(end, math.inf)
        newest = math.isinf(since) and bool(nb_values)
        backwards = newest or since > until
        since, until = min(since, until), max(since, until)
        # Without a start, no further page can be read backwards.
        largest = MOST_ROWS if newest else _MOST
        most = min(nb_values or largest, largest)
        machine, variable = self.variables[node_id]
        found = await asyncio.to_thread(
            self.archive.samples, machine, (since, until), most + 1, backwards
        )
        values = [data_value(variable.kind, *variable.value(one), one) for one in found[:most]]
        if len(found) <= most or most == nb_values or newest:
            return values, None
        # The next page begins with this sample, whose time may not be a whole microsecond.
        time = found[most].time + (_MICROSECOND if backwards else -_MICROSECOND)
        return values, datetime.fromtimestamp(time, UTC)


def _seconds(time: datetime | None, otherwise: float) -> float:
    return otherwise if time is None or time.year < _FIRST_YEAR else since_1970(time)


def is_archived(variable: Variable) -> bool:
    """Return whether the archive has the values of a variable."""
    return bool(variable.folder) or variable.name in ("Status", "Quality", "SampleNumber")
