"""Parameters of a Magic Formula tire, with their names in property files."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from math import inf
from types import MappingProxyType
from typing import Literal

Version = Literal["5.2", "6.1", "6.2"]

# MF 5.2 is MF 6.1 without these terms (and with the camber shift PHY3, see Eq. 4.E27): no pressure,
# no separate camber stiffness, and the constant 2 in sin(2 arctan(...)).
_ABSENT_IN_52 = """
    PPX1 PPX2 PPX3 PPX4 RBX3 PEY5 PKY5 PKY6 PKY7 PPY1 PPY2 PPY3 PPY4 PPY5 RBY4
    QDZ10 QDZ11 PPZ1 PPZ2 LMUV
"""
_CONSTANT_IN_52 = dict.fromkeys(_ABSENT_IN_52.split(), 0.0) | {
    "PKY4": 2.0,
    "LKYC": 1.0,
    "LKZC": 1.0,
    "NOMPRES": 1.0,
    "PRESMIN": -inf,
    "PRESMAX": inf,
}
_CONSTANT_IN_6 = {"PHY3": 0.0, "LGAX": 1.0, "LGAY": 1.0, "LGAZ": 1.0}

CONSTANTS = MappingProxyType(
    {
        "5.2": MappingProxyType(_CONSTANT_IN_52),
        "6.1": MappingProxyType(_CONSTANT_IN_6),
        "6.2": MappingProxyType(_CONSTANT_IN_6),
    }
)
"""For each version, the terms that are absent, with values that remove them."""


class InvalidParameterError(ValueError):
    """Error for an impossible value of a parameter; `key` is its name."""

    def __init__(self, key: str, problem: str) -> None:
        super().__init__(key, problem)
        self.key = key
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.key}: {self.problem}"


@dataclass(frozen=True, kw_only=True)
class MagicFormulaParameters:
    """All numbers of the force equations, in SI units (Pacejka, 3rd ed., Ch. 4.3 and App. 3).

    Coefficients (P, Q, R, S) have no default. Scaling factors (L) default to 1 (LMUV to 0), as
    listed in the book, and ranges default to infinity. Coefficients are dimensionless or refer to
    radians, independent of the angle unit of a file. Raises `InvalidParameterError` for impossible
    values.
    """

    version: Version

    # Nominal load [N], unloaded radius [m], reference speed V0 [m/s], nominal pressure [Pa].
    FNOMIN: float
    UNLOADED_RADIUS: float
    LONGVL: float
    NOMPRES: float

    # Valid ranges: load [N], slip ratio [1], slip angle [rad], camber [rad], pressure [Pa].
    FZMIN: float = 0.0
    FZMAX: float = inf
    KPUMIN: float = -inf
    KPUMAX: float = inf
    ALPMIN: float = -inf
    ALPMAX: float = inf
    CAMMIN: float = -inf
    CAMMAX: float = inf
    PRESMIN: float = -inf
    PRESMAX: float = inf

    # Longitudinal force: shape, friction, curvature, stiffness, shifts, pressure, combined slip.
    PCX1: float
    PDX1: float
    PDX2: float
    PDX3: float
    PEX1: float
    PEX2: float
    PEX3: float
    PEX4: float
    PKX1: float
    PKX2: float
    PKX3: float
    PHX1: float
    PHX2: float
    PVX1: float
    PVX2: float
    PPX1: float
    PPX2: float
    PPX3: float
    PPX4: float
    RBX1: float
    RBX2: float
    RBX3: float
    RCX1: float
    REX1: float
    REX2: float
    RHX1: float

    # Lateral force, in the same order.
    PCY1: float
    PDY1: float
    PDY2: float
    PDY3: float
    PEY1: float
    PEY2: float
    PEY3: float
    PEY4: float
    PEY5: float
    PKY1: float
    PKY2: float
    PKY3: float
    PKY4: float
    PKY5: float
    PKY6: float
    PKY7: float
    PHY1: float
    PHY2: float
    PHY3: float
    PVY1: float
    PVY2: float
    PVY3: float
    PVY4: float
    PPY1: float
    PPY2: float
    PPY3: float
    PPY4: float
    PPY5: float
    RBY1: float
    RBY2: float
    RBY3: float
    RBY4: float
    RCY1: float
    REY1: float
    REY2: float
    RHY1: float
    RHY2: float
    RVY1: float
    RVY2: float
    RVY3: float
    RVY4: float
    RVY5: float
    RVY6: float

    # Aligning moment: pneumatic trail, residual moment, arm of the longitudinal force.
    QBZ1: float
    QBZ2: float
    QBZ3: float
    QBZ4: float
    QBZ5: float
    QBZ9: float
    QBZ10: float
    QCZ1: float
    QDZ1: float
    QDZ2: float
    QDZ3: float
    QDZ4: float
    QDZ6: float
    QDZ7: float
    QDZ8: float
    QDZ9: float
    QDZ10: float
    QDZ11: float
    QEZ1: float
    QEZ2: float
    QEZ3: float
    QEZ4: float
    QEZ5: float
    QHZ1: float
    QHZ2: float
    QHZ3: float
    QHZ4: float
    PPZ1: float
    PPZ2: float
    SSZ1: float
    SSZ2: float
    SSZ3: float
    SSZ4: float

    # Scaling factors; LGAX, LGAY and LGAZ scale camber in MF 5.2, LKYC and LKZC in MF 6.
    LFZO: float = 1.0
    LCX: float = 1.0
    LMUX: float = 1.0
    LEX: float = 1.0
    LKX: float = 1.0
    LHX: float = 1.0
    LVX: float = 1.0
    LGAX: float = 1.0
    LCY: float = 1.0
    LMUY: float = 1.0
    LEY: float = 1.0
    LKY: float = 1.0
    LHY: float = 1.0
    LVY: float = 1.0
    LGAY: float = 1.0
    LKYC: float = 1.0
    LTR: float = 1.0
    LRES: float = 1.0
    LGAZ: float = 1.0
    LKZC: float = 1.0
    LXAL: float = 1.0
    LYKA: float = 1.0
    LVYKA: float = 1.0
    LS: float = 1.0
    LMUV: float = 0.0

    def __post_init__(self) -> None:
        for key in ("FNOMIN", "UNLOADED_RADIUS", "LONGVL", "NOMPRES", "LFZO", "LMUX", "LMUY"):
            if not getattr(self, key) > 0:
                raise InvalidParameterError(key, f"{getattr(self, key)} is not a positive number")
        if self.PKY2 == 0:
            raise InvalidParameterError("PKY2", "0 leaves the cornering stiffness undefined")
        for quantity in ("FZ", "KPU", "ALP", "CAM", "PRES"):
            low, high = getattr(self, f"{quantity}MIN"), getattr(self, f"{quantity}MAX")
            if not low <= high:
                raise InvalidParameterError(
                    f"{quantity}MAX", f"{high} is below {quantity}MIN = {low}"
                )


def parameter_names(version: Version) -> frozenset[str]:
    """Return the names of the parameters in the equations of a version."""
    return frozenset(f.name for f in fields(MagicFormulaParameters)) - {
        "version",
        *CONSTANTS[version],
    }


def required_names(version: Version) -> frozenset[str]:
    """Return the names that a file of a version must contain: parameters without a default."""
    defaults = {f.name for f in fields(MagicFormulaParameters) if f.default is not MISSING}
    return parameter_names(version) - defaults
