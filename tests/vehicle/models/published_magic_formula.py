"""The Magic Formula once more, equation by equation, with the choices of other implementations.

Written from Pacejka, Tire and Vehicle Dynamics, 3rd ed. 2012, Ch. 4.3.2, and from Besselink,
Schmeitz and Pacejka, Vehicle System Dynamics 48 (2010) S1, without turn slip, for Vx > 0. It shares
nothing with `miho.vehicle.models.magic_formula` but the names of coefficients.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy import arctan, cos, sign, sin, tan

from miho.quantities import Array

CAMBER_OF_TRAIL = "B_t, D_t and s take the camber itself, not gamma*"
COSINE = "cos' alpha of the residual moment is that of alpha* as an angle"
LOAD = "the trail is taken times LFZO, and s has FNOMIN without LFZO"
FRICTION = "S_Vyk at the trail of MF 5.2 has the friction at no camber"
UPRIGHT = "G_yk at the trail of MF 6 is that without camber"
BOOK: frozenset[str] = frozenset()
MFEVAL = frozenset({CAMBER_OF_TRAIL, COSINE, LOAD, FRICTION})


def curve(x: Array, B: Any, C: Any, E: Any) -> Array:
    """C arctan(B x - E (B x - arctan(B x)))."""
    return C * arctan(B * x - E * (B * x - arctan(B * x)))


def at_most_one(E: Any) -> Array:
    return np.minimum(E, 1.0)


def weight(slip: Array, shift: Any, B: Any, C: Any, E: Any) -> Array:
    return cos(curve(slip + shift, B, C, E)) / cos(curve(0 * slip + shift, B, C, E))


class PublishedForces:
    """Fx, Fy [N] and Mz [Nm] of coefficients `p` at conditions (N,), by the book or `choices`."""

    def __init__(
        self, p: Any, Fz: Array, kappa: Array, alpha: Array, gamma: Array, Vx: Array,
        pressure: Array, *, alpha_star: bool = False, choices: Collection[str] = BOOK,
    ) -> None:  # fmt: skip
        self.p, self.Fz, self.kappa, self.camber, self.choices = p, Fz, kappa, gamma, choices
        self.nominal = p.LFZO * p.FNOMIN
        self.dfz = Fz / self.nominal - 1
        self.dpi = 0 * Fz if p.version == "5.2" else pressure / p.NOMPRES - 1
        self.alpha = tan(alpha) if alpha_star else alpha
        self.gamma = sin(gamma) if alpha_star else gamma
        self.cosine = Vx / (Vx / cos(alpha) + 1e-6)
        sliding = 1 + p.LMUV * Vx * np.sqrt(kappa**2 + tan(alpha) ** 2) / p.LONGVL
        self.mu_x, self.mu_y = p.LMUX / sliding, p.LMUY / sliding
        self.longitudinal()
        self.Fy, self.at_trail = self.lateral(self.gamma * p.LGAY)
        self.Mz = self.moment()

    def longitudinal(self) -> None:
        p, dfz, dpi, Fz = self.p, self.dfz, self.dpi, self.Fz
        kappa_x = self.kappa + (p.PHX1 + p.PHX2 * dfz) * p.LHX
        mu = (p.PDX1 + p.PDX2 * dfz) * (1 - p.PDX3 * (self.camber * p.LGAX) ** 2) * self.mu_x
        D = mu * (1 + p.PPX3 * dpi + p.PPX4 * dpi**2) * Fz
        E = (p.PEX1 + p.PEX2 * dfz + p.PEX3 * dfz**2) * (1 - p.PEX4 * sign(kappa_x)) * p.LEX
        self.K_x = Fz * (p.PKX1 + p.PKX2 * dfz) * np.exp(p.PKX3 * dfz) * p.LKX
        self.K_x = self.K_x * (1 + p.PPX1 * dpi + p.PPX2 * dpi**2)
        C = p.PCX1 * p.LCX
        Fx0 = D * sin(curve(kappa_x, self.K_x / (C * D), C, at_most_one(E)))
        Fx0 = Fx0 + Fz * (p.PVX1 + p.PVX2 * dfz) * p.LVX * self.mu_x
        B = (p.RBX1 + p.RBX3 * self.gamma**2) * cos(arctan(p.RBX2 * self.kappa)) * p.LXAL
        E = at_most_one(p.REX1 + p.REX2 * dfz)
        self.Fx = Fx0 * weight(self.alpha, p.RHX1, B, p.RCX1, E)

    def lateral(self, gamma: Array) -> tuple[Array, Array]:
        """The lateral force, and the one that acts at the pneumatic trail."""
        p = self.p
        upright, upright_mu = self.pure(0 * gamma)
        Fy0, mu = self.pure(gamma)  # last, since the moment reads its factors
        G, S = self.loss(gamma), self.shift(mu, gamma)
        Fy = G * Fy0 + S
        if p.version == "5.2":
            mu_at_trail = upright_mu if FRICTION in self.choices else mu
            return Fy, Fy - self.shift(mu_at_trail, gamma)
        return Fy, upright * (self.loss(0 * gamma) if UPRIGHT in self.choices else G)

    def pure(self, gamma: Array) -> tuple[Array, Array]:
        """Lateral force at no slip ratio, and its friction; keeps what the moment reads."""
        p, dfz, dpi, Fz = self.p, self.dfz, self.dpi, self.Fz
        mu = (p.PDY1 + p.PDY2 * dfz) * (1 - p.PDY3 * gamma**2) * self.mu_y
        mu = mu * (1 + p.PPY3 * dpi + p.PPY4 * dpi**2)
        load = Fz / self.nominal / ((p.PKY2 + p.PKY5 * gamma**2) * (1 + p.PPY2 * dpi))
        K = p.PKY1 * self.nominal * (1 + p.PPY1 * dpi) * (1 - p.PKY3 * abs(gamma))
        K = K * sin(p.PKY4 * arctan(load)) * p.LKY
        S_V_gamma = Fz * (p.PVY3 + p.PVY4 * dfz) * gamma * p.LKYC * self.mu_y
        S_V = Fz * (p.PVY1 + p.PVY2 * dfz) * p.LVY * self.mu_y + S_V_gamma
        S_H = (p.PHY1 + p.PHY2 * dfz) * p.LHY
        if p.version == "5.2":
            S_H = S_H + p.PHY3 * gamma
        else:
            K_gamma = Fz * (p.PKY6 + p.PKY7 * dfz) * (1 + p.PPY5 * dpi) * p.LKYC
            S_H = S_H + (K_gamma * gamma - S_V_gamma) / K
        alpha_y = self.alpha + S_H
        C, D = p.PCY1 * p.LCY, mu * Fz
        E = (p.PEY1 + p.PEY2 * dfz) * p.LEY
        E = E * (1 + p.PEY5 * gamma**2 - (p.PEY3 + p.PEY4 * gamma) * sign(alpha_y))
        B = K / (C * D)
        self.K_y, self.BC, self.alpha_r = K, B * C, self.alpha + S_H + S_V / K
        return D * sin(curve(alpha_y, B, C, at_most_one(E))) + S_V, mu

    def loss(self, gamma: Array) -> Array:
        """G_yk, 4.E59."""
        p = self.p
        B = (p.RBY1 + p.RBY4 * gamma**2) * cos(arctan(p.RBY2 * (self.alpha - p.RBY3))) * p.LYKA
        E = at_most_one(p.REY1 + p.REY2 * self.dfz)
        return weight(self.kappa, p.RHY1 + p.RHY2 * self.dfz, B, p.RCY1, E)

    def shift(self, mu: Array, gamma: Array) -> Array:
        """S_Vyk, 4.E66."""
        p = self.p
        D = mu * self.Fz * (p.RVY1 + p.RVY2 * self.dfz + p.RVY3 * gamma)
        D = D * cos(arctan(p.RVY4 * self.alpha))
        return D * sin(p.RVY5 * arctan(p.RVY6 * self.kappa)) * p.LVYKA

    def moment(self) -> Array:
        """Aligning moment; QBZ4 and QDZ3 with the camber's sign, alpha_eq by tangents (2010)."""
        p, dfz, dpi, R0 = self.p, self.dfz, self.dpi, self.p.UNLOADED_RADIUS
        gamma = self.gamma * p.LGAZ
        camber = self.camber * p.LGAZ if CAMBER_OF_TRAIL in self.choices else gamma
        alpha_t = self.alpha + p.QHZ1 + p.QHZ2 * dfz + (p.QHZ3 + p.QHZ4 * dfz) * gamma
        B = (p.QBZ1 + p.QBZ2 * dfz + p.QBZ3 * dfz**2) * p.LKY / self.mu_y
        B = B * (1 + p.QBZ4 * camber + p.QBZ5 * abs(camber))
        D = self.Fz * R0 / self.nominal * (p.QDZ1 + p.QDZ2 * dfz) * (1 - p.PPZ1 * dpi) * p.LTR
        D = D * (1 + p.QDZ3 * camber + p.QDZ4 * camber**2)
        E = 1 + (p.QEZ4 + p.QEZ5 * gamma) * 2 / np.pi * arctan(B * p.QCZ1 * alpha_t)
        E = at_most_one((p.QEZ1 + p.QEZ2 * dfz + p.QEZ3 * dfz**2) * E)
        D_r = (p.QDZ8 + p.QDZ9 * dfz) * (1 + p.PPZ2 * dpi)
        D_r = (D_r + (p.QDZ10 + p.QDZ11 * dfz) * abs(gamma)) * gamma * p.LKZC
        D_r = self.Fz * R0 * ((p.QDZ6 + p.QDZ7 * dfz) * p.LRES + D_r) * self.mu_y
        D_r = D_r * (cos(self.alpha) if COSINE in self.choices else self.cosine)
        B_r = p.QBZ9 * p.LKY / self.mu_y + p.QBZ10 * self.BC
        slip = (self.K_x / self.K_y * self.kappa) ** 2
        alpha_r, alpha_t = (
            arctan(np.sqrt(tan(a) ** 2 + slip)) * sign(a) for a in (self.alpha_r, alpha_t)
        )
        trail = D * cos(curve(alpha_t, B, p.QCZ1, E)) * self.cosine
        nominal = self.nominal
        if LOAD in self.choices:
            trail, nominal = trail * p.LFZO, p.FNOMIN
        leaning = self.camber if CAMBER_OF_TRAIL in self.choices else gamma
        arm = p.SSZ1 + p.SSZ2 * self.Fy / nominal + (p.SSZ3 + p.SSZ4 * dfz) * leaning
        residual = D_r * cos(arctan(B_r * alpha_r))
        return -trail * self.at_trail + residual + R0 * arm * p.LS * self.Fx
