"""Forces of a Magic Formula tire as a compiled function of its slips and load.

`MagicFormula` evaluates arrays; a simulation evaluates single wheels about ten thousand times per
simulated second. The equations (4.E9-4.E30 and 4.E50-4.E67, numbered as in `MagicFormula`) are
reduced to fixed pressure and inclination of a wheel, so their terms become constants. Values agree
with `MagicFormula.forces` up to rounding.
"""

from __future__ import annotations

from math import atan, cos, inf, sin
from typing import Any

import numpy as np

from miho.vehicle.driving.compiling import part, record_of
from miho.vehicle.models.magic_formula import MagicFormula

Tires = tuple[MagicFormula, MagicFormula, MagicFormula, MagicFormula]
"""Tires front left, front right, rear left, rear right, never mirrored."""


def wheel_tire(tire: MagicFormula, gamma: float = 0.0, pressure: float | None = None) -> Any:
    """Return the tire at an inclination [rad], ISO-W, and a pressure [Pa], by default nominal.

    The result is a record of all `MagicFormulaParameters`, and of terms that are constant at this
    inclination and pressure.
    """
    p = tire.parameters
    old = p.version == "5.2"
    if not np.isfinite(gamma):
        raise ValueError(f"inclination is {gamma}; expected a finite angle [rad]")
    pressure = p.NOMPRES if pressure is None else pressure
    ranges: dict[str, float] = {}
    if tire.clamp_inputs:
        gamma = float(np.clip(gamma, p.CAMMIN, p.CAMMAX))
        pressure = float(np.clip(pressure, p.PRESMIN, p.PRESMAX))
    else:
        ranges = dict.fromkeys(("KPUMIN", "ALPMIN"), -inf) | {"FZMIN": 0.0}
        ranges |= dict.fromkeys(("KPUMAX", "ALPMAX", "FZMAX"), inf)
    dpi = 0.0 if old else pressure / p.NOMPRES - 1  # 4.E2b
    gamma_x, gamma_y = (gamma * p.LGAX if old else gamma), gamma * p.LGAY
    nominal = p.LFZO * p.FNOMIN
    stiffened = p.PKY1 * nominal * (1 + p.PPY1 * dpi) * (1 - p.PKY3 * abs(gamma_y))
    constants = {
        "nominal": nominal,
        "gamma_y": gamma_y,
        "mu_x": (1 + p.PPX3 * dpi + p.PPX4 * dpi**2) * (1 - p.PDX3 * gamma_x**2),  # 4.E13
        "mu_y": (1 + p.PPY3 * dpi + p.PPY4 * dpi**2) * (1 - p.PDY3 * gamma_y**2),  # 4.E23
        "K_x": (1 + p.PPX1 * dpi + p.PPX2 * dpi**2) * p.LKX,  # 4.E15
        "K_y": stiffened * p.LKY,  # 4.E25
        "load_at_peak": nominal * (p.PKY2 + p.PKY5 * gamma_y**2) * (1 + p.PPY2 * dpi),
        "K_gamma": (1 + p.PPY5 * dpi) * p.LKYC * gamma_y,  # 4.E30, times gamma
        "E_y_even": 1 + p.PEY5 * gamma_y**2,  # 4.E24
        "B_x_alpha": (p.RBX1 + p.RBX3 * gamma**2) * p.LXAL,  # 4.E54
        "B_y_kappa": (p.RBY1 + p.RBY4 * gamma_y**2) * p.LYKA,  # 4.E62
        "camber_shift": 0.0 if old else 1.0,  # SH_y has (K_gamma - SV_gamma) / K (4.E27)
        "shift_52": p.PHY3 * gamma_y if old else 0.0,
        "still": tire.epsilon if tire.fade_at_standstill and not old else 0.0,  # 4.E18 [m/s]
        "E_max": 1.0 if tire.clamp_curvature else inf,
        "epsilon": tire.epsilon,
        "A_mu": tire.A_mu,
    }
    return record_of(vars(p) | ranges | constants)


@part
def wheel_forces(
    p: Any, load: float, kappa: float, alpha: float, Vx: float, friction: float = 1.0
) -> tuple[float, float]:
    """Return Fx, Fy [N] for load [N], slip ratio, slip angle [rad] and wheel centre speed [m/s].

    ISO-W signs and limits are as in `MagicFormula.forces` with alpha_star False. friction [-] is
    the friction of the road relative to the road of the tire measurement. It multiplies LMUX and
    LMUY, the scaling factors of the peaks. Stiffnesses are unchanged, and the vertical shifts fade
    as in 4.E8.
    """
    load = max(load, 0.0)
    Fz = min(max(load, p.FZMIN), p.FZMAX)
    kappa = min(max(kappa, p.KPUMIN), p.KPUMAX)
    alpha = min(max(alpha, p.ALPMIN), p.ALPMAX)
    loaded = min(load / Fz, 1.0) if p.FZMIN > 0 else 1.0
    dfz = (Fz - p.nominal) / p.nominal  # 4.E2a
    decay = 1.0
    if p.LMUV > 0:
        decay += p.LMUV / p.LONGVL * abs(Vx) * np.hypot(kappa, np.tan(alpha))  # 4.E7
    Fx = _longitudinal(p, Fz, dfz, kappa, alpha, Vx, friction * p.LMUX / decay)
    Fy = _lateral(p, Fz, dfz, kappa, alpha, friction * p.LMUY / decay)
    return loaded * Fx, loaded * Fy


@part
def _longitudinal(
    p: Any, Fz: float, dfz: float, kappa: float, alpha: float, Vx: float, friction: float
) -> float:
    rolling = abs(Vx) / (p.still + abs(Vx)) if p.still > 0 else 1.0
    SV = Fz * (p.PVX1 * p.LVX + p.PVX2 * p.LVX * dfz) * rolling * _faded(p, friction)  # 4.E18
    kappa_x = kappa + p.PHX1 * p.LHX + p.PHX2 * p.LHX * dfz  # 4.E10
    D = (p.PDX1 * p.mu_x + p.PDX2 * p.mu_x * dfz) * friction * Fz  # 4.E12
    E = p.PEX1 * p.LEX + p.PEX2 * p.LEX * dfz + p.PEX3 * p.LEX * dfz * dfz
    E = min(E * (1 - p.PEX4 * np.sign(kappa_x)), p.E_max)  # 4.E14
    K = Fz * (p.PKX1 * p.K_x + p.PKX2 * p.K_x * dfz) * np.exp(p.PKX3 * dfz)  # 4.E15
    C = p.PCX1 * p.LCX  # 4.E11
    B = K / (C * D + p.epsilon)  # 4.E16
    Fx0 = D * sin(C * atan(_argument(kappa_x, B, E))) + SV  # 4.E9
    # cos(atan(x)) = 1 / sqrt(1 + x^2)
    B = p.B_x_alpha / np.sqrt(1 + (p.RBX2 * kappa) ** 2)  # 4.E54
    E = min(p.REX1 + p.REX2 * dfz, p.E_max)  # 4.E56
    G: float = _weight(alpha, p.RHX1, B, p.RCX1, E) * Fx0  # 4.E50-4.E53
    return G


@part
def _lateral(p: Any, Fz: float, dfz: float, kappa: float, alpha: float, friction: float) -> float:
    K = p.K_y * sin(p.PKY4 * atan(Fz / p.load_at_peak))  # 4.E25
    faded = _faded(p, friction)
    SV_gamma = p.PVY3 * p.gamma_y * p.LKYC + p.PVY4 * p.gamma_y * p.LKYC * dfz
    SV_gamma = Fz * SV_gamma * faded  # 4.E28
    SV = Fz * (p.PVY1 * p.LVY + p.PVY2 * p.LVY * dfz) * faded + SV_gamma  # 4.E29
    K_gamma = Fz * (p.PKY6 * p.K_gamma + p.PKY7 * p.K_gamma * dfz)  # 4.E30, times gamma
    K_prime = K - p.epsilon if K < 0 else K + p.epsilon  # 4.E39
    SH = p.PHY1 * p.LHY + p.shift_52 + p.PHY2 * p.LHY * dfz
    SH += p.camber_shift * (K_gamma - SV_gamma) / K_prime  # 4.E27
    alpha_y = alpha + SH  # 4.E20
    D = (p.PDY1 * p.mu_y + p.PDY2 * p.mu_y * dfz) * friction * Fz  # 4.E22
    side = (p.PEY3 + p.PEY4 * p.gamma_y) * np.sign(alpha_y)
    E = (p.PEY1 * p.LEY + p.PEY2 * p.LEY * dfz) * (p.E_y_even - side)
    E = min(E, p.E_max)  # 4.E24
    C = p.PCY1 * p.LCY  # 4.E21
    B = K / (C * D + p.epsilon)  # 4.E26
    Fy0 = D * sin(C * atan(_argument(alpha_y, B, E))) + SV  # 4.E19
    B = p.B_y_kappa / np.sqrt(1 + (p.RBY2 * (alpha - p.RBY3)) ** 2)  # 4.E62
    E = min(p.REY1 + p.REY2 * dfz, p.E_max)  # 4.E64
    G = _weight(kappa, p.RHY1 + p.RHY2 * dfz, B, p.RCY1, E)  # 4.E59-4.E61
    D_V = D * (p.RVY1 + p.RVY3 * p.gamma_y + p.RVY2 * dfz)
    D_V /= np.sqrt(1 + (p.RVY4 * alpha) ** 2)  # 4.E67
    SV_kappa = D_V * sin(p.RVY5 * atan(p.RVY6 * kappa)) * p.LVYKA  # 4.E66
    Fy: float = G * Fy0 + SV_kappa  # 4.E58
    return Fy


@part
def _faded(p: Any, friction: float) -> float:
    faded: float = p.A_mu * friction / (1 + (p.A_mu - 1) * friction)  # 4.E8
    return faded


@part
def _argument(slip: float, B: float, E: float) -> float:
    x = B * slip
    y: float = x - E * (x - atan(x))
    return y


@part
def _weight(slip: float, shift: float, B: float, C: float, E: float) -> float:
    at_zero = cos(C * atan(_argument(shift, B, E)))
    w: float = cos(C * atan(_argument(slip + shift, B, E))) / at_zero
    return w
