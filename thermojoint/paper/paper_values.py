"""Values printed by Attia & Fraser for their structure, for comparison.

Tables 1-3 and sections 5.2-5.3 of "Real-time adaptive modeling approach to compensate the thermal
deformation of nonlinear machine tool structures". No units are printed with the parameters; the
distances of Table 2 are of the order of centimetres on that structure.
"""

from __future__ import annotations

CITATION = "Attia & Fraser, Real-time adaptive modeling ..., Tables 1-3"

TABLE1_THERMAL = dict(
    zip(
        ("K", "a", "alpha", "r", "r0", "A", "B", "gamma"),
        (3.372, 3.20, 0.000212, 0.19, 0.12, 5.59e-3, 8.25e-6, 0.290),
        strict=True,
    )
)

TABLE1_DEFORMATION = {
    "x": {"C": 0.1695, "D": -1.255, "E": -0.04785, "c": 0.0089, "d": 0.00129, "e": 0.0097},
    "y": {"C": 3.845, "D": 2.355, "E": -0.0354, "c": 0.00123, "d": 0.00142, "e": 0.0338},
}

_TABLE2_COLUMNS = ("a", "alpha", "K", "q 2.0", "q 0.5", "A", "B", "gamma")
#: One entry for each fictitious source; "q 2.0" is its strength at heat input 2.0.
TABLE2 = tuple(
    dict(zip(_TABLE2_COLUMNS, row, strict=True))
    for row in (
        (0.025, 0.0841, 3.73, 2.3e-4, 0.0289, 0.00203, 7.34e-4, 0.0574),
        (0.0361, 0.0799, 3.73, 1.0, -0.124, 0.00369, 1.26e-4, 0.0268),
    )
)

#: r_ij as printed: from source i to sensor T_j.
TABLE2_DISTANCES = ((4.89, 12.47), (10.84, 6.21))

#: Axis to one entry for each source (the print's columns, taken in order).
TABLE3 = {
    axis: tuple(dict(zip("CDEFcdef", row, strict=True)) for row in rows)
    for axis, rows in {
        "x": (
            (0.767, 1.20, -0.0145, 0.0189, 0.00971, 0.00441, 0.00849, 0.0199),
            (-0.737, 1.87, -0.0135, 0.0178, 0.0120, 0.00289, 0.0077, 0.0191),
        ),
        "y": (
            (-0.241, -6.29, 0.0357, 0.201, 0.00312, 0.00462, 0.0123, 0.205),
            (-0.111, -7.27, -0.123, 0.179, 0.0022, 0.00489, 0.0157, 0.0201),
        ),
    }.items()
}

#: Largest error of the estimated displacement (section 5.3), µm.
VALIDATION_ERROR_UM = {"step-1.5": 0.1, "step-3.0": 0.5, "triangle": 0.15, "triangle-noise": 0.5}

#: Largest difference of the calibrated from the actual displacement (section 5.3.1), µm.
CALIBRATION_ERROR_UM = 0.1

#: Fraction of the steady change that the contact pressure under compression reaches in one minute.
PRESSURE_SHARE = 0.75
