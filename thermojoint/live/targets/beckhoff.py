"""Beckhoff TwinCAT CNC: temperature compensation by P-AXIS-00271 to 00274.

Units, types and ranges: infosys.beckhoff.com, TF5200 CNC, axis parameters (P-AXIS-00272 to 00274),
and temperature compensation, CNC objects (TEMPC::offset_0). The TwinCAT OPC UA server shows
variables of the PLC, which passes them on to these objects. The names of the variables are
therefore chosen by the user.
"""

from __future__ import annotations

from thermojoint.live.targets.control import Control, Quantity

_LARGEST = float(2**31 - 1)


def _parameter(number: int, name: str, unit: str, metres: float, largest: float) -> Quantity:
    return Quantity(
        name=f"P-AXIS-{number:05d} lr_param.{name}",
        unit=unit,
        metres=metres,
        step=1.0,
        largest=largest,
        whole=True,
        node=f"ns=4;s=Thermal.{name}[{{axis}}]",
        line=f"lr_param.{name} {{value}}",
    )


BECKHOFF = Control(
    title="Beckhoff TwinCAT CNC",
    offset=_parameter(273, "temp_comp_offset_0", "0.1 µm", 1e-7, _LARGEST),
    slope=_parameter(274, "temp_comp_coefficient", "µm/m", 1e-6, _LARGEST),
    reference=_parameter(272, "temp_comp_position_0", "0.1 µm", 1e-7, _LARGEST),
    switch=_parameter(271, "temp_comp", "", 1.0, 1.0),
    with_slope=1.0,
    comment="#",
    heading="kopf.achs_nr {axis}",
)
