"""Values printed by Attia & Fraser for their structure, for comparison.

Tables 1-3 and sections 5.2-5.3 of "Real-time adaptive modeling approach to compensate the thermal
deformation of nonlinear machine tool structures". No units are printed with the parameters; the
distances of Table 2 are of the order of centimetres on that structure.
"""

from __future__ import annotations

CITATION = "Attia & Fraser, Real-time adaptive modeling ..., Tables 1-3"

TABLE1_THERMAL = {
    "K": 3.372,
    "a": 3.20,
    "alpha": 0.000212,
    "r": 0.19,
    "r0": 0.12,
    "A": 5.59e-3,
    "B": 8.25e-6,
    "gamma": 0.290,
}

TABLE1_DEFORMATION = {
    "x": {"C": 0.1695, "D": -1.255, "E": -0.04785, "c": 0.0089, "d": 0.00129, "e": 0.0097},
    "y": {"C": 3.845, "D": 2.355, "E": -0.0354, "c": 0.00123, "d": 0.00142, "e": 0.0338},
}

#: One entry for each fictitious source; "q 2.0" is its strength at heat input 2.0.
TABLE2 = (
    {
        "a": 0.025,
        "alpha": 0.0841,
        "K": 3.73,
        "q 2.0": 2.3e-4,
        "q 0.5": 0.0289,
        "A": 0.00203,
        "B": 7.34e-4,
        "gamma": 0.0574,
    },
    {
        "a": 0.0361,
        "alpha": 0.0799,
        "K": 3.73,
        "q 2.0": 1.0,
        "q 0.5": -0.124,
        "A": 0.00369,
        "B": 1.26e-4,
        "gamma": 0.0268,
    },
)

#: r_ij as printed: from source i to sensor T_j.
TABLE2_DISTANCES = ((4.89, 12.47), (10.84, 6.21))

#: Axis to one entry for each source (the print's columns, taken in order).
TABLE3 = {
    "x": (
        {
            "C": 0.767,
            "D": 1.20,
            "E": -0.0145,
            "F": 0.0189,
            "c": 0.00971,
            "d": 0.00441,
            "e": 0.00849,
            "f": 0.0199,
        },
        {
            "C": -0.737,
            "D": 1.87,
            "E": -0.0135,
            "F": 0.0178,
            "c": 0.0120,
            "d": 0.00289,
            "e": 0.0077,
            "f": 0.0191,
        },
    ),
    "y": (
        {
            "C": -0.241,
            "D": -6.29,
            "E": 0.0357,
            "F": 0.201,
            "c": 0.00312,
            "d": 0.00462,
            "e": 0.0123,
            "f": 0.205,
        },
        {
            "C": -0.111,
            "D": -7.27,
            "E": -0.123,
            "F": 0.179,
            "c": 0.0022,
            "d": 0.00489,
            "e": 0.0157,
            "f": 0.0201,
        },
    ),
}

#: Largest error of the estimated displacement (section 5.3), µm.
VALIDATION_ERROR_UM = {"step-1.5": 0.1, "step-3.0": 0.5, "triangle": 0.15, "triangle-noise": 0.5}

#: Largest difference of the calibrated from the actual displacement (section 5.3.1), µm.
CALIBRATION_ERROR_UM = 0.1

#: Share of its steady value that the contact pressure under compression reaches in one minute.
PRESSURE_SHARE = 0.75
