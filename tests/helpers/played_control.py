"""A server with the documented node names of a control, and what was written into it."""

import math
import re
import time

from asyncua import Server, ua
from live_parts import free_port
from repository import ROOT

from thermojoint.live.targets.settings import read_target

PAGES = {
    name: (ROOT / "docs" / f"guide-{name}.md").read_text("utf-8")
    for name in ("sinumerik", "beckhoff")
}


class Played:
    """A control whose file of a target, that of its page, is written to a path.

    `record` is what was written: times (s) and offsets (um); `slopes` the same of slopes (um/m),
    where `more`, the end of the file, says that it takes one.
    """

    def __init__(self, path, kind, step_um, enable=True, more=""):
        text = re.search(r"^```toml target[^\n]*\n(.*?)^```", PAGES[kind], re.M | re.S)[1]
        self.port = free_port()
        for old, new in (
            ('url = ".*"', f'url = "opc.tcp://127.0.0.1:{self.port}"'),
            ("largest_step_um = .*", f"largest_step_um = {step_um}"),
            ("enable = .*", f"enable = {str(enable).lower()}"),
            ("(server_certificate|user|password) = .*\n", ""),
        ):
            text = re.sub(old, new, text)
        path.write_text(f'security = "none"\n{text}{more}')
        self.given = read_target(path)
        self.server, self.nodes, self.record, self.slopes = None, {}, [], []

    async def open(self, **values):
        """Start it with values by the short names of quantities."""
        self.server = Server()
        await self.server.init()
        self.server.set_endpoint(f"opc.tcp://127.0.0.1:{self.port}")
        for k in range(2, 5):
            await self.server.register_namespace(f"urn:played:{k}")
        for quantity in self.given.control.quantities:
            node = ua.NodeId.from_string(self.given.node(quantity, "Z"))
            begins = 1 if quantity is self.given.control.switch else 0
            value = values.get(quantity.name.split()[0], begins)
            made = await self.server.nodes.objects.add_variable(
                node, f"{node.NamespaceIndex}:{quantity.name}",
                self.variant(quantity, value),
            )  # fmt: skip
            await made.set_writable()
            self.nodes[quantity.name.split()[0]] = made
        offset = self.given.control.offset
        self.offset = self.nodes[offset.name.split()[0]]
        self.server.iserver.aspace.add_datachange_callback(
            self.offset.nodeid, ua.AttributeIds.Value, self.written
        )
        if self.given.slopes:
            slope = self.nodes[self.given.control.slope.name.split()[0]]
            self.server.iserver.aspace.add_datachange_callback(
                slope.nodeid, ua.AttributeIds.Value, self.slope_written
            )
        await self.server.start()

    async def returns(self, cold):
        """Start it again with what it had, or with nothing."""
        offset = self.given.control.offset
        value = 0 if cold else await self.offset.read_value()
        if cold:
            self.record += [(time.monotonic(), math.nan), (time.monotonic(), 0.0)]
        await self.open(**{offset.name.split()[0]: value})

    async def clears(self):
        """Somebody else sets the offset to zero."""
        self.record.append((time.monotonic(), math.nan))
        await self.offset.write_value(self.variant(self.given.control.offset, 0))

    async def written(self, handle, value):
        self.record.append((time.monotonic(), self.um(value.Value.Value)))

    async def slope_written(self, handle, value):
        metres = self.given.control.slope.metres
        self.slopes.append((time.monotonic(), 1e6 * metres * value.Value.Value))

    @staticmethod
    def variant(quantity, value):
        if quantity.whole:
            return ua.Variant(int(value), ua.VariantType.Int32)
        return ua.Variant(float(value), ua.VariantType.Double)

    def um(self, value):
        return 1e6 * self.given.control.offset.metres * value

    @property
    def newest(self):
        return self.record[-1][1] if self.record else 0.0
