"""Forces of a Magic Formula tire as a compiled function of its slips and load.

`MagicFormula` evaluates arrays; a simulation evaluates single wheels about ten thousand times per
simulated second. The equations (4.E9-4.E30 and 4.E50-4.E67, numbered as in `MagicFormula`) are
reduced to fixed pressure and inclination of a wheel, so their terms become constants. Values agree
with `MagicFormula.forces` up to rounding.
"""

from __future__ import annotations

from math import atan, cos, sin
from typing import NamedTuple

import numpy as np

from miho.vehicle.driving.compiling import part
from miho.vehicle.models.magic_formula import MagicFormula


class WheelTire(NamedTuple):
    """A tire at a fixed pressure and inclination; pairs are (value at FNOMIN, slope over dfz)."""

    nominal: float  # LFZO FNOMIN [N]
    Fz_range: tuple[float, float]  # [N]
    kappa_range: tuple[float, float]
    alpha_range: tuple[float, float]  # [rad]
    epsilon: float
    E_max: float
    slip_decay: float  # LMUV / LONGVL [s/m]
    A_mu: float
    still: float  # added to |Vx| under the shift SV_x [m/s]

    LMUX: float
    mu_x: tuple[float, float]
    C_x: float
    E_x: tuple[float, float, float]
    E_x_side: float
    K_x: tuple[float, float]
    K_x_exponent: float
    SH_x: tuple[float, float]
    SV_x: tuple[float, float]
    B_x_alpha: tuple[float, float]  # amplitude and RBX2
    C_x_alpha: float
    E_x_alpha: tuple[float, float]
    SH_x_alpha: float

    LMUY: float
    mu_y: tuple[float, float]
    C_y: float
    E_y: tuple[float, float]
    E_y_even: float
    E_y_side: float
    K_y_peak: float
    PKY4: float
    load_at_peak: float
    K_gamma: tuple[float, float]
    SH_y: tuple[float, float]
    SV_y: tuple[float, float]
    SV_gamma: tuple[float, float]
    camber_shift: float  # 1: SH_y holds (K_gamma - SV_gamma) / K (4.E27); 0 in MF 5.2
    B_y_kappa: tuple[float, float, float]  # amplitude, RBY2, RBY3
    C_y_kappa: float
    E_y_kappa: tuple[float, float]
    SH_y_kappa: tuple[float, float]
    D_V: tuple[float, float]
    RVY4: float
    LVYKA: float
    RVY5: float
    RVY6: float


def wheel_tire(tire: MagicFormula, gamma: float = 0.0, pressure: float | None = None) -> WheelTire:
    """Return the tire at an inclination [rad], ISO-W, and a pressure [Pa], by default nominal."""
    p = tire.parameters
    old = p.version == "5.2"
    if not np.isfinite(gamma):
        raise ValueError(f"inclination is {gamma}; expected a finite angle [rad]")
    unlimited = (-np.inf, np.inf)
    pressure = p.NOMPRES if pressure is None else pressure
    if tire.clamp_inputs:
        gamma = float(np.clip(gamma, p.CAMMIN, p.CAMMAX))
        pressure = float(np.clip(pressure, p.PRESMIN, p.PRESMAX))
    dpi = 0.0 if old else pressure / p.NOMPRES - 1  # 4.E2b
    gamma_x, gamma_y = (gamma * p.LGAX if old else gamma), gamma * p.LGAY
    mu_x = (1 + p.PPX3 * dpi + p.PPX4 * dpi**2) * (1 - p.PDX3 * gamma_x**2)  # 4.E13
    mu_y = (1 + p.PPY3 * dpi + p.PPY4 * dpi**2) * (1 - p.PDY3 * gamma_y**2)  # 4.E23
    K_x = (1 + p.PPX1 * dpi + p.PPX2 * dpi**2) * p.LKX  # 4.E15
    K_peak = p.PKY1 * p.LFZO * p.FNOMIN * (1 + p.PPY1 * dpi) * (1 - p.PKY3 * abs(gamma_y))
    load_at_peak = p.LFZO * p.FNOMIN * (p.PKY2 + p.PKY5 * gamma_y**2) * (1 + p.PPY2 * dpi)
    K_gamma = (1 + p.PPY5 * dpi) * p.LKYC * gamma_y  # 4.E30, times gamma
    side = p.PEY3 + p.PEY4 * gamma_y
    return WheelTire(
        nominal=p.LFZO * p.FNOMIN,
        Fz_range=(p.FZMIN, p.FZMAX) if tire.clamp_inputs else (0.0, np.inf),
        kappa_range=(p.KPUMIN, p.KPUMAX) if tire.clamp_inputs else unlimited,
        alpha_range=(p.ALPMIN, p.ALPMAX) if tire.clamp_inputs else unlimited,
        epsilon=tire.epsilon,
        E_max=1.0 if tire.clamp_curvature else np.inf,
        slip_decay=p.LMUV / p.LONGVL,
        A_mu=tire.A_mu,
        still=tire.epsilon if tire.fade_at_standstill and not old else 0.0,
        LMUX=p.LMUX,
        mu_x=(p.PDX1 * mu_x, p.PDX2 * mu_x),
        C_x=p.PCX1 * p.LCX,
        E_x=(p.PEX1 * p.LEX, p.PEX2 * p.LEX, p.PEX3 * p.LEX),
        E_x_side=p.PEX4,
        K_x=(p.PKX1 * K_x, p.PKX2 * K_x),
        K_x_exponent=p.PKX3,
        SH_x=(p.PHX1 * p.LHX, p.PHX2 * p.LHX),
        SV_x=(p.PVX1 * p.LVX, p.PVX2 * p.LVX),
        B_x_alpha=((p.RBX1 + p.RBX3 * gamma**2) * p.LXAL, p.RBX2),
        C_x_alpha=p.RCX1,
        E_x_alpha=(p.REX1, p.REX2),
        SH_x_alpha=p.RHX1,
        LMUY=p.LMUY,
        mu_y=(p.PDY1 * mu_y, p.PDY2 * mu_y),
        C_y=p.PCY1 * p.LCY,
        E_y=(p.PEY1 * p.LEY, p.PEY2 * p.LEY),
        E_y_even=1 + p.PEY5 * gamma_y**2,
        E_y_side=side,
        K_y_peak=K_peak * p.LKY,
        PKY4=p.PKY4,
        load_at_peak=load_at_peak,
        K_gamma=(p.PKY6 * K_gamma, p.PKY7 * K_gamma),
        SH_y=(p.PHY1 * p.LHY + (p.PHY3 * gamma_y if old else 0.0), p.PHY2 * p.LHY),
        SV_y=(p.PVY1 * p.LVY, p.PVY2 * p.LVY),
        SV_gamma=(p.PVY3 * gamma_y * p.LKYC, p.PVY4 * gamma_y * p.LKYC),
        camber_shift=0.0 if old else 1.0,
        B_y_kappa=((p.RBY1 + p.RBY4 * gamma_y**2) * p.LYKA, p.RBY2, p.RBY3),
        C_y_kappa=p.RCY1,
        E_y_kappa=(p.REY1, p.REY2),
        SH_y_kappa=(p.RHY1, p.RHY2),
        D_V=(p.RVY1 + p.RVY3 * gamma_y, p.RVY2),
        RVY4=p.RVY4,
        LVYKA=p.LVYKA,
        RVY5=p.RVY5,
        RVY6=p.RVY6,
    )


@part
def wheel_forces(
    p: WheelTire, load: float, kappa: float, alpha: float, Vx: float, friction: float = 1.0
) -> tuple[float, float]:
    """Return Fx, Fy [N] for load [N], slip ratio, slip angle [rad] and wheel centre speed [m/s].

    ISO-W signs and limits are as in `MagicFormula.forces` with alpha_star False. friction [-] is
    the friction of the road relative to the road of the tire measurement. It multiplies LMUX and
    LMUY, the scaling factors of the peaks. Stiffnesses are unchanged, and the vertical shifts fade
    as in 4.E8.
    """
    load = max(load, 0.0)
    Fz = min(max(load, p.Fz_range[0]), p.Fz_range[1])
    kappa = min(max(kappa, p.kappa_range[0]), p.kappa_range[1])
    alpha = min(max(alpha, p.alpha_range[0]), p.alpha_range[1])
    loaded = min(load / Fz, 1.0) if p.Fz_range[0] > 0 else 1.0
    dfz = (Fz - p.nominal) / p.nominal  # 4.E2a
    decay = 1.0
    if p.slip_decay > 0:
        decay += p.slip_decay * abs(Vx) * np.hypot(kappa, np.tan(alpha))  # 4.E7
    Fx = _longitudinal(p, Fz, dfz, kappa, alpha, Vx, friction * p.LMUX / decay)
    Fy = _lateral(p, Fz, dfz, kappa, alpha, friction * p.LMUY / decay)
    return loaded * Fx, loaded * Fy


@part
def _longitudinal(
    p: WheelTire, Fz: float, dfz: float, kappa: float, alpha: float, Vx: float, friction: float
) -> float:
    rolling = abs(Vx) / (p.still + abs(Vx)) if p.still > 0 else 1.0
    SV = Fz * (p.SV_x[0] + p.SV_x[1] * dfz) * rolling * _faded(p, friction)  # 4.E18
    kappa_x = kappa + p.SH_x[0] + p.SH_x[1] * dfz  # 4.E10
    D = (p.mu_x[0] + p.mu_x[1] * dfz) * friction * Fz  # 4.E12
    E = p.E_x[0] + p.E_x[1] * dfz + p.E_x[2] * dfz * dfz
    E = min(E * (1 - p.E_x_side * np.sign(kappa_x)), p.E_max)  # 4.E14
    K = Fz * (p.K_x[0] + p.K_x[1] * dfz) * np.exp(p.K_x_exponent * dfz)  # 4.E15
    B = K / (p.C_x * D + p.epsilon)  # 4.E16
    Fx0 = D * sin(p.C_x * atan(_argument(kappa_x, B, E))) + SV  # 4.E9
    # cos(atan(x)) = 1 / sqrt(1 + x^2)
    B = p.B_x_alpha[0] / np.sqrt(1 + (p.B_x_alpha[1] * kappa) ** 2)  # 4.E54
    E = min(p.E_x_alpha[0] + p.E_x_alpha[1] * dfz, p.E_max)  # 4.E56
    G: float = _weight(alpha, p.SH_x_alpha, B, p.C_x_alpha, E) * Fx0  # 4.E50-4.E53
    return G


@part
def _lateral(
    p: WheelTire, Fz: float, dfz: float, kappa: float, alpha: float, friction: float
) -> float:
    K = p.K_y_peak * sin(p.PKY4 * atan(Fz / p.load_at_peak))  # 4.E25
    faded = _faded(p, friction)
    SV_gamma = Fz * (p.SV_gamma[0] + p.SV_gamma[1] * dfz) * faded  # 4.E28
    SV = Fz * (p.SV_y[0] + p.SV_y[1] * dfz) * faded + SV_gamma  # 4.E29
    K_gamma = Fz * (p.K_gamma[0] + p.K_gamma[1] * dfz)  # 4.E30, times gamma
    K_prime = K - p.epsilon if K < 0 else K + p.epsilon  # 4.E39
    SH = p.SH_y[0] + p.SH_y[1] * dfz + p.camber_shift * (K_gamma - SV_gamma) / K_prime  # 4.E27
    alpha_y = alpha + SH  # 4.E20
    D = (p.mu_y[0] + p.mu_y[1] * dfz) * friction * Fz  # 4.E22
    E = (p.E_y[0] + p.E_y[1] * dfz) * (p.E_y_even - p.E_y_side * np.sign(alpha_y))
    E = min(E, p.E_max)  # 4.E24
    B = K / (p.C_y * D + p.epsilon)  # 4.E26
    Fy0 = D * sin(p.C_y * atan(_argument(alpha_y, B, E))) + SV  # 4.E19
    B = p.B_y_kappa[0] / np.sqrt(1 + (p.B_y_kappa[1] * (alpha - p.B_y_kappa[2])) ** 2)  # 4.E62
    E = min(p.E_y_kappa[0] + p.E_y_kappa[1] * dfz, p.E_max)  # 4.E64
    shift = p.SH_y_kappa[0] + p.SH_y_kappa[1] * dfz
    G = _weight(kappa, shift, B, p.C_y_kappa, E)  # 4.E59-4.E61
    D_V = D * (p.D_V[0] + p.D_V[1] * dfz) / np.sqrt(1 + (p.RVY4 * alpha) ** 2)  # 4.E67
    SV_kappa = D_V * sin(p.RVY5 * atan(p.RVY6 * kappa)) * p.LVYKA  # 4.E66
    Fy: float = G * Fy0 + SV_kappa  # 4.E58
    return Fy


@part
def _faded(p: WheelTire, friction: float) -> float:
    return p.A_mu * friction / (1 + (p.A_mu - 1) * friction)  # 4.E8


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
