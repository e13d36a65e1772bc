"""The vocabulary of tire property files: sections, keys, and the unit of each."""

from __future__ import annotations

from math import pi
from types import MappingProxyType

# Factors to SI units for each quantity of [UNITS], by the spellings in property files.
UNIT_FACTORS = MappingProxyType(
    {
        "LENGTH": {
            "meter": 1.0, "meters": 1.0, "metre": 1.0, "m": 1.0,
            "centimeter": 0.01, "cm": 0.01, "millimeter": 0.001, "mm": 0.001,
            "kilometer": 1000.0, "km": 1000.0, "inch": 0.0254, "in": 0.0254,
            "foot": 0.3048, "ft": 0.3048,
        },
        "FORCE": {
            "newton": 1.0, "n": 1.0, "kilonewton": 1000.0, "kn": 1000.0,
            "kilogram_force": 9.80665, "kgf": 9.80665,
            "pound_force": 4.4482216152605, "lbf": 4.4482216152605,
        },
        "ANGLE": {
            "radian": 1.0, "radians": 1.0, "rad": 1.0,
            "degree": pi / 180, "degrees": pi / 180, "deg": pi / 180,
        },
        "MASS": {
            "kg": 1.0, "kilogram": 1.0, "gram": 0.001, "g": 0.001,
            "pound_mass": 0.45359237, "lbm": 0.45359237, "slug": 14.593902937206,
        },
        "TIME": {
            "second": 1.0, "seconds": 1.0, "sec": 1.0, "s": 1.0,
            "millisecond": 0.001, "ms": 0.001, "minute": 60.0, "min": 60.0, "hour": 3600.0,
        },
    }
)  # fmt: skip

# [UNITS] may also have a unit of pressure; by default it is force over length squared.
PRESSURE_FACTORS = MappingProxyType(
    {
        "pascal": 1.0, "pa": 1.0, "newton/meter^2": 1.0, "kpa": 1000.0, "kilopascal": 1000.0,
        "mpa": 1e6, "megapascal": 1e6, "bar": 1e5, "psi": 6894.757293168362,
    }
)  # fmt: skip

SI_UNITS = MappingProxyType(
    {"LENGTH": "meter", "FORCE": "newton", "ANGLE": "radian", "MASS": "kg", "TIME": "second"}
)

# Exponents of (length, force, angle, mass, time). Coefficients are not converted: the Magic Formula
# uses radians, so ANGLE applies to the ranges and the yaw stiffness only.
_LENGTH, _FORCE, _ANGLE, _MASS = (1, 0, 0, 0, 0), (0, 1, 0, 0, 0), (0, 0, 1, 0, 0), (0, 0, 0, 1, 0)
_SPEED, _FREQUENCY, PRESSURE = (1, 0, 0, 0, -1), (0, 0, 0, 0, -1), (-2, 1, 0, 0, 0)
_INERTIA, _STIFFNESS, _DAMPING = (2, 0, 0, 1, 0), (-1, 1, 0, 0, 0), (-1, 1, 0, 0, 1)

Dimension = tuple[int, int, int, int, int]

DIMENSIONS: MappingProxyType[tuple[str, str], Dimension] = MappingProxyType(
    {
        (section, key): dimension
        for section, dimension, keys in (
            ("MODEL", _SPEED, "LONGVL VXLOW"),
            ("MODEL", _LENGTH, "ROAD_INCREMENT HMAX_LOCAL"),
            ("DIMENSION", _LENGTH, "UNLOADED_RADIUS WIDTH RIM_RADIUS RIM_WIDTH"),
            ("OPERATING_CONDITIONS", PRESSURE, "INFLPRES NOMPRES"),
            ("INERTIA", _MASS, "MASS BELT_MASS"),
            ("INERTIA", _INERTIA, "IXX IYY BELT_IXX BELT_IYY"),
            ("INERTIA", (1, 0, 0, 0, -2), "GRAVITY"),
            ("VERTICAL", _FORCE, "FNOMIN"),
            ("VERTICAL", _STIFFNESS, "VERTICAL_STIFFNESS BOTTOM_STIFF"),
            ("VERTICAL", _DAMPING, "VERTICAL_DAMPING"),
            ("VERTICAL", _LENGTH, "BOTTOM_OFFST"),
            ("STRUCTURAL", _STIFFNESS, "LONGITUDINAL_STIFFNESS LATERAL_STIFFNESS"),
            ("STRUCTURAL", (1, 1, -1, 0, 0), "YAW_STIFFNESS"),
            ("STRUCTURAL", _FREQUENCY, "FREQ_LONG FREQ_LAT FREQ_YAW FREQ_WINDUP"),
            ("CONTACT_PATCH", _LENGTH, "ELLIPS_MAX_STEP"),
            ("INFLATION_PRESSURE_RANGE", PRESSURE, "PRESMIN PRESMAX"),
            ("VERTICAL_FORCE_RANGE", _FORCE, "FZMIN FZMAX"),
            ("SLIP_ANGLE_RANGE", _ANGLE, "ALPMIN ALPMAX"),
            ("INCLINATION_ANGLE_RANGE", _ANGLE, "CAMMIN CAMMAX"),
            ("ALIGNING_COEFFICIENTS", _MASS, "MBELT"),
        )
        for key in keys.split()
    }
)

# Sections whose lines are rows of numbers, with the dimensions of their columns.
TABLES: MappingProxyType[str, tuple[Dimension, ...]] = MappingProxyType(
    {
        "SHAPE": ((0, 0, 0, 0, 0), (0, 0, 0, 0, 0)),
        "DEFLECTION_LOAD_CURVE": (_LENGTH, _FORCE),
        "BOTTOMING_CURVE": (_LENGTH, _FORCE),
    }
)


def _numbered(*families: str) -> str:
    """Expand ranges: 'PCX1-3 PDX4' becomes 'PCX1 PCX2 PCX3 PDX4'."""
    names = []
    for family in " ".join(families).split():
        stem = family.rstrip("0123456789-")
        first, _, last = family[len(stem) :].partition("-")
        names += [f"{stem}{i}" for i in range(int(first), int(last or first) + 1)]
    return " ".join(names)


TURNSLIP_NAMES = ("TURNSLIP_COEFFICIENTS", "TURNSLIP")
_TURNSLIP = _numbered("PDXP1-3 PKYP1 PDYP1-4 PHYP1-4 PECP1-2 QDTP1 QCRP1-2 QBRP1 QDRP1-2")

KEYS: MappingProxyType[str, frozenset[str]] = MappingProxyType(
    {
        section: frozenset(" ".join(keys).split())
        for section, *keys in (
            ("MDI_HEADER", "FILE_TYPE FILE_VERSION FILE_FORMAT"),
            ("UNITS", "LENGTH FORCE ANGLE MASS TIME PRESSURE"),
            (
                "MODEL",
                "FITTYP TYRESIDE LONGVL VXLOW ROAD_INCREMENT ROAD_DIRECTION TYPE FUNCTION_NAME",
                "PROPERTY_FILE_FORMAT USER_SUB_ID N_TIRE_STATES USE_MODE HMAX_LOCAL",
                "SWITCH_INTEG TIME_SWITCH_INTEG",
                # keys of Adams
                "CONTACT_MODEL MESSAGES FE_METHOD MFSAFE1 MFSAFE2 MFSAFE3",
            ),
            ("DIMENSION", "UNLOADED_RADIUS WIDTH ASPECT_RATIO RIM_RADIUS RIM_WIDTH"),
            ("OPERATING_CONDITIONS", "INFLPRES NOMPRES"),
            ("INERTIA", "MASS IXX IYY BELT_MASS BELT_IXX BELT_IYY GRAVITY"),
            (
                "VERTICAL",
                "FNOMIN VERTICAL_STIFFNESS VERTICAL_DAMPING MC_CONTOUR_A MC_CONTOUR_B BREFF DREFF",
                "FREFF Q_RE0 Q_FCX Q_FCY Q_FCY2 Q_CAM PFZ1 BOTTOM_OFFST BOTTOM_STIFF",
                _numbered("Q_V1-2 Q_FZ1-3 Q_CAM1-3 Q_FYS1-3"),
            ),
            (
                "STRUCTURAL",
                "LONGITUDINAL_STIFFNESS LATERAL_STIFFNESS YAW_STIFFNESS FREQ_LONG FREQ_LAT",
                "FREQ_YAW FREQ_WINDUP DAMP_LONG DAMP_LAT DAMP_YAW DAMP_WINDUP DAMP_RESIDUAL",
                "DAMP_VLOW Q_BVX Q_BVT",
                _numbered("PCFX1-3 PCFY1-3 PCMZ1"),
            ),
            (
                "CONTACT_PATCH",
                "ELLIPS_SHIFT ELLIPS_LENGTH ELLIPS_HEIGHT ELLIPS_ORDER ELLIPS_MAX_STEP",
                "ELLIPS_NWIDTH ELLIPS_NLENGTH ELLIPS_INC ENV_C1 ENV_C2 CONTACT_MODEL",
                _numbered("Q_RA1-2 Q_RB1-2 Q_A1-2"),
            ),
            *((table,) for table in TABLES),
            ("INFLATION_PRESSURE_RANGE", "PRESMIN PRESMAX"),
            ("VERTICAL_FORCE_RANGE", "FZMIN FZMAX"),
            ("LONG_SLIP_RANGE", "KPUMIN KPUMAX"),
            ("SLIP_ANGLE_RANGE", "ALPMIN ALPMAX"),
            ("INCLINATION_ANGLE_RANGE", "CAMMIN CAMMAX"),
            (
                "SCALING_COEFFICIENTS",
                "LFZO LCX LMUX LEX LKX LHX LVX LGAX LCY LMUY LEY LKY LHY LVY LGAY LKYC LTR LRES",
                "LGAZ LKZC LXAL LYKA LVYKA LS LSGKP LSGAL LGYR LMX LVMX LMY LMP LMUV LCZ",
            ),
            (
                "LONGITUDINAL_COEFFICIENTS",
                _numbered("PCX1 PDX1-3 PEX1-4 PKX1-3 PHX1-2 PVX1-2 PPX1-4"),
                _numbered("RBX1-3 RCX1 REX1-2 RHX1 PTX1-3"),
            ),
            ("OVERTURNING_COEFFICIENTS", _numbered("QSX1-14 PPMX1")),
            (
                "LATERAL_COEFFICIENTS",
                _numbered("PCY1 PDY1-3 PEY1-5 PKY1-7 PHY1-3 PVY1-4 PPY1-5"),
                _numbered("RBY1-4 RCY1 REY1-2 RHY1-2 RVY1-6 PTY1-3"),
            ),
            ("ROLLING_COEFFICIENTS", _numbered("QSY1-8")),
            (
                "ALIGNING_COEFFICIENTS",
                _numbered("QBZ1-5 QBZ9-10 QCZ1 QDZ1-4 QDZ6-11 QEZ1-5 QHZ1-4 PPZ1-2 SSZ1-4 QTZ1"),
                "MBELT",
            ),
            *((name, _TURNSLIP) for name in TURNSLIP_NAMES),
        )
    }
)
"""Allowed keys of each section, over all versions."""

SECTION_OF = MappingProxyType(
    {
        key: section
        for section, keys in KEYS.items()
        if section not in ("UNITS", "INERTIA", "MDI_HEADER")
        for key in keys
    }
)
"""Section of each model parameter."""
