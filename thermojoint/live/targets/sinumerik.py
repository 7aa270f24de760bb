"""Siemens SINUMERIK 840D sl and 828D: temperature compensation by setting data (K3).

Quantities, and the effect of MD32750 and MD32760: Function Manual Extended Functions, K3, 03/2013,
6FC5397-1BP40-3BA1. Names of nodes: Access MyMachine / OPC UA, Commissioning Manual 10/2015,
6FC5397-3DP40-5BA3, 4.3.4; it shows channel data only, the names of axis data follow the same rule.
"""

from __future__ import annotations

from dataclasses import replace

from thermojoint.live.targets.control import Control, Quantity


def _setting(number: int, name: str, unit: str, metres: float) -> Quantity:
    return Quantity(
        name=f"SD{number} $SA_{name}",
        unit=unit,
        metres=metres,
        step=1e-6,
        largest=10.0,
        whole=False,
        node=f"ns=2;s=/NC/_N_AX_SEA_ACX/$SA_{name}[u{{axis}}]",
        line=f"$SA_{name}[AX{{axis}}]={{value}}",
    )


SINUMERIK = Control(
    title="Siemens SINUMERIK 840D sl, 828D (metric)",
    offset=_setting(43900, "TEMP_COMP_ABS_VALUE", "mm", 1e-3),
    slope=_setting(43910, "TEMP_COMP_SLOPE", "mm/mm", 1.0),
    reference=replace(_setting(43920, "TEMP_COMP_REF_POSITION", "mm", 1e-3), largest=1e6),
    switch=Quantity(
        name="MD32750 $MA_TEMP_COMP_TYPE",
        unit="",
        metres=1.0,
        step=1.0,
        largest=7.0,
        whole=True,
        node="ns=2;s=/NC/_N_AX_TEA_ACX/$MA_TEMP_COMP_TYPE[u{axis}]",
        line="$MA_TEMP_COMP_TYPE[AX{axis}]={value}",
    ),
    # Bit 0: the same value at every position; bit 1: along the axis.
    with_slope=3.0,
    comment=";",
    ending=("M17",),
)
