"""Steady-state tire forces by the Magic Formula, versions 5.2, 6.1 and 6.2.

Equation numbers (4.E1-4.E78) are from Pacejka, Tire and Vehicle Dynamics, 3rd ed., Ch. 4.3.2;
turn slip is not included (all zeta = 1). MF 5.2 is implemented as MF 6.1 without its additional
terms, with further differences marked below. MF 6.2 has the forces of MF 6.1.

Implementations agree on Fx and Fy. For Mz, this module follows the book in three cases in which the
reference values of the tests (MFeval 4.0) differ. With the choices of the reference, the published
equations give its moments to 1e-9 of the largest (tests/vehicle/models/test_magic_formula.py):

    MF 5.2    the force at the trail is F_y - S_Vyk. In the book, S_Vyk has the friction of F_y,
              which falls with camber; the reference uses the friction without camber
    alpha*    B_t and D_t (4.E40, 4.E43) and the arm s (4.E76) use gamma* in the book, and the
              camber in the reference; cos' alpha of the residual moment (4.E47) is V_x / V in the
              book, and the cosine of alpha* in the reference
    LFZO      if not 1, the reference multiplies the trail by LFZO, and uses F_y / FNOMIN in s
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from miho.quantities import Array
from miho.vehicle.models.magic_formula_parameters import MagicFormulaParameters


class TireForces(NamedTuple):
    """Force on the tire at the contact point, ISO-W axes: Fx, Fy [N], aligning moment Mz [Nm]."""

    Fx: Array
    Fy: Array
    Mz: Array


class Conditions(NamedTuple):
    """Inputs after the range limits, with quantities that all equations share."""

    Fz: Array
    kappa: Array
    alpha: Array  # alpha or alpha*
    gamma: Array  # gamma or gamma*
    inclination: Array  # gamma in both modes, for the friction of Fx (4.E13)
    Vx: Array
    dfz: Array
    dpi: Array
    cosine: Array  # cos' alpha
    mu_x: Array  # lambda*_mu_x
    mu_y: Array  # lambda*_mu_y
    loaded: Array  # factor of the forces below the smallest load


class _Longitudinal(NamedTuple):
    Fx: Array
    K: Array


class PureLateral(NamedTuple):
    """Lateral force without longitudinal slip, and its factors (4.E19-4.E30)."""

    Fy: Array
    alpha_y: Array
    B: Array
    C: Array
    D: Array
    E: Array
    K: Array
    K_prime: Array
    SH: Array
    SV: Array


class _Lateral(NamedTuple):
    Fy: Array
    G: Array  # the loss to longitudinal slip, G_yk
    pure: PureLateral


@dataclass(frozen=True)
class MagicFormula:
    """A tire: its parameters, and options that the literature leaves open.

    Parameters
    ----------
    parameters : MagicFormulaParameters
        Coefficients, ranges and scaling factors.
    clamp_curvature : bool, optional
        Limit each E to at most 1, as the book requires (4.E14); larger values give curves with
        reversed slopes.
    clamp_inputs : bool, optional
        Evaluate inputs outside the ranges of the parameters at the ends of the ranges.
    fade_at_standstill : bool, optional
        Multiply the vertical shift of Fx in MF 6 by |Vx| / (epsilon + |Vx|) (4.E18), for
        simulations that stop. The factor is 1 to six digits above 1 m/s.
    epsilon : float, optional
        Small number that keeps denominators different from 0.
    A_mu : float, optional
        Fading of the vertical shifts on slippery ground (4.E8). The book suggests 10; 1 disables
        the fading, as in MF-Tyre.
    """

    parameters: MagicFormulaParameters
    clamp_curvature: bool = True
    clamp_inputs: bool = True
    fade_at_standstill: bool = False
    epsilon: float = 1e-6
    A_mu: float = 1.0

    with_parameters = 'miho.vehicle.models.TireFormula(tire, ("PDY1", "PKY1"), "Fy")'

    def forces(
        self,
        Fz: ArrayLike,
        kappa: ArrayLike,
        alpha: ArrayLike,
        gamma: ArrayLike = 0.0,
        Vx: ArrayLike | None = None,
        pressure: ArrayLike | None = None,
        alpha_star: bool = False,
    ) -> TireForces:
        """Return the forces for inputs that broadcast together.

        In ISO-W axes (x forward, y left, z up), a positive slip angle gives a negative lateral
        force, a positive slip ratio drives, and a positive inclination leans the top of the wheel
        to the right. The tire is used as its file describes it, and is never mirrored.

        Parameters
        ----------
        Fz : array_like
            Wheel load [N]. Below FZMIN, forces fall in proportion to the load; a lifted wheel
            (Fz <= 0) has no force.
        kappa : array_like
            Slip ratio [1], -1 for a locked wheel.
        alpha : array_like
            Slip angle [rad].
        gamma : array_like, optional
            Inclination (camber) [rad].
        Vx : array_like, optional
            Speed of the wheel centre [m/s], not 0; by default LONGVL.
        pressure : array_like, optional
            Inflation pressure [Pa]; by default NOMPRES. MF 5.2 ignores it.
        alpha_star : bool, optional
            If true, use alpha* = tan(alpha) sgn(Vx) and gamma* = sin(gamma) of the book (4.E3,
            4.E4), but gamma in the friction of Fx (4.E13). By default, use the angles, as MF-Tyre
            does.

        Returns
        -------
        TireForces
            Forces [N] and moment [Nm] of the broadcast shape; NaN for NaN inputs.
        """
        p = self.parameters
        inputs = np.broadcast_arrays(
            *(
                np.asarray(value, dtype=float)
                for value in (
                    Fz,
                    kappa,
                    alpha,
                    gamma,
                    p.LONGVL if Vx is None else Vx,
                    p.NOMPRES if pressure is None else pressure,
                )
            )
        )
        c = self.conditions(*inputs, alpha_star=alpha_star)
        return TireForces(*map(np.asarray, self.forces_at(c)))

    def model_for(self, *arguments: Any) -> Any:
        """Return the model of a force; see `miho.fitting.protocols.Template`."""
        from miho.vehicle.models.tire_formula import tire_model

        return tire_model(self, *arguments)

    def forces_at(self, c: Conditions) -> TireForces:
        """Return the forces at conditions, which may be symbols (`miho.models.symbolic`)."""
        x = self._longitudinal(c)
        y = self._lateral(c, c.gamma * self.parameters.LGAY)
        Mz = self._aligning_moment(c, x, y)
        return TireForces(c.loaded * x.Fx, c.loaded * y.Fy, c.loaded * Mz)

    def conditions(
        self,
        Fz: Array,
        kappa: Array,
        alpha: Array,
        gamma: Array,
        Vx: Array,
        pressure: Array,
        *,
        alpha_star: bool = False,
    ) -> Conditions:
        """Return the conditions for inputs of one shape; arguments as in `forces`."""
        p = self.parameters
        load = Fz = np.maximum(Fz, 0.0)
        if self.clamp_inputs:
            Fz = np.clip(Fz, p.FZMIN, p.FZMAX)
            kappa = np.clip(kappa, p.KPUMIN, p.KPUMAX)
            alpha = np.clip(alpha, p.ALPMIN, p.ALPMAX)
            gamma = np.clip(gamma, p.CAMMIN, p.CAMMAX)
            pressure = np.clip(pressure, p.PRESMIN, p.PRESMAX)
        tan_alpha, speed = np.tan(alpha), np.abs(Vx)
        slip_speed = speed * np.hypot(kappa, tan_alpha)
        decay = 1 + p.LMUV * slip_speed / p.LONGVL  # 4.E7
        nominal = p.LFZO * p.FNOMIN  # 4.E1
        loaded = load / Fz if self.clamp_inputs and p.FZMIN > 0 else 1.0
        return Conditions(
            Fz=Fz,
            kappa=kappa,
            alpha=tan_alpha * np.sign(Vx) if alpha_star else alpha,  # 4.E3
            gamma=np.sin(gamma) if alpha_star else gamma,  # 4.E4
            inclination=gamma,
            Vx=Vx,
            dfz=(Fz - nominal) / nominal,  # 4.E2a
            dpi=0.0 * Fz if p.version == "5.2" else pressure / p.NOMPRES - 1,  # 4.E2b
            cosine=Vx / (speed * np.hypot(1, tan_alpha) + self.epsilon),  # 4.E6
            mu_x=p.LMUX / decay,
            mu_y=p.LMUY / decay,
            loaded=np.minimum(loaded, 1.0),
        )

    def _longitudinal(self, c: Conditions) -> _Longitudinal:
        p, e, dfz, dpi = self.parameters, self.epsilon, c.dfz, c.dpi
        fades = self.fade_at_standstill and p.version != "5.2"
        rolling = np.abs(c.Vx) / (e + np.abs(c.Vx)) if fades else 1.0
        mu = (p.PDX1 + p.PDX2 * dfz) * (1 + p.PPX3 * dpi + p.PPX4 * dpi**2)
        mu = mu * (1 - p.PDX3 * (c.inclination * p.LGAX) ** 2) * c.mu_x  # 4.E13
        SH = (p.PHX1 + p.PHX2 * dfz) * p.LHX  # 4.E17
        SV = c.Fz * (p.PVX1 + p.PVX2 * dfz) * rolling * p.LVX * self.faded(c.mu_x)  # 4.E18
        kappa_x = c.kappa + SH  # 4.E10
        C = p.PCX1 * p.LCX  # 4.E11
        D = mu * c.Fz  # 4.E12
        E = p.PEX1 + p.PEX2 * dfz + p.PEX3 * dfz**2
        E = self._curvature(E * (1 - p.PEX4 * np.sign(kappa_x)) * p.LEX)  # 4.E14
        K = c.Fz * (p.PKX1 + p.PKX2 * dfz) * np.exp(p.PKX3 * dfz)
        K = K * (1 + p.PPX1 * dpi + p.PPX2 * dpi**2) * p.LKX  # 4.E15
        B = K / (C * D + e)  # 4.E16
        Fx0 = D * np.sin(C * np.arctan(_argument(kappa_x, B, E))) + SV  # 4.E9

        B = (p.RBX1 + p.RBX3 * c.gamma**2) * np.cos(np.arctan(p.RBX2 * c.kappa)) * p.LXAL  # 4.E54
        E = self._curvature(p.REX1 + p.REX2 * dfz)  # 4.E56
        G = _weight(c.alpha, p.RHX1, B, p.RCX1, E)  # 4.E51-4.E53
        return _Longitudinal(Fx=G * Fx0, K=K)  # 4.E50

    def pure_lateral(self, c: Conditions, gamma: Array, p: Any) -> PureLateral:
        """Return the lateral force without longitudinal slip and without the factor `c.loaded`.

        p: object with the attributes of `MagicFormulaParameters`; coefficients may be columns
        (n, 1) that broadcast with the conditions.
        """
        e, dfz, dpi = self.epsilon, c.dfz, c.dpi
        mu = (p.PDY1 + p.PDY2 * dfz) * (1 + p.PPY3 * dpi + p.PPY4 * dpi**2)
        mu = mu * (1 - p.PDY3 * gamma**2) * c.mu_y  # 4.E23
        nominal = p.LFZO * p.FNOMIN
        K_peak = p.PKY1 * nominal * (1 + p.PPY1 * dpi) * (1 - p.PKY3 * np.abs(gamma))
        load_at_peak = nominal * (p.PKY2 + p.PKY5 * gamma**2) * (1 + p.PPY2 * dpi)
        K = K_peak * np.sin(p.PKY4 * np.arctan(c.Fz / load_at_peak)) * p.LKY  # 4.E25
        K_prime = K + np.where(K < 0, -e, e)  # 4.E39
        faded = self.faded(c.mu_y)
        SV_gamma = c.Fz * (p.PVY3 + p.PVY4 * dfz) * gamma * p.LKYC * faded  # 4.E28
        SV = c.Fz * (p.PVY1 + p.PVY2 * dfz) * p.LVY * faded + SV_gamma  # 4.E29
        SH = (p.PHY1 + p.PHY2 * dfz) * p.LHY
        if p.version == "5.2":
            SH = SH + p.PHY3 * gamma
        else:
            K_gamma = c.Fz * (p.PKY6 + p.PKY7 * dfz) * (1 + p.PPY5 * dpi) * p.LKYC  # 4.E30
            SH = SH + (K_gamma * gamma - SV_gamma) / K_prime  # 4.E27
        alpha_y = c.alpha + SH  # 4.E20
        C = p.PCY1 * p.LCY  # 4.E21
        D = mu * c.Fz  # 4.E22
        E = (p.PEY1 + p.PEY2 * dfz) * p.LEY
        side = (p.PEY3 + p.PEY4 * gamma) * np.sign(alpha_y)
        E = self._curvature(E * (1 + p.PEY5 * gamma**2 - side))  # 4.E24
        B = K / (C * D + e)  # 4.E26
        Fy0 = D * np.sin(C * np.arctan(_argument(alpha_y, B, E))) + SV  # 4.E19
        return PureLateral(Fy0, alpha_y, B, C, D, E, K, K_prime, SH, SV)

    def _lateral(self, c: Conditions, gamma: Array) -> _Lateral:
        p, dfz = self.parameters, c.dfz
        pure = self.pure_lateral(c, gamma, p)
        B_kappa = np.cos(np.arctan(p.RBY2 * (c.alpha - p.RBY3)))
        B_kappa = (p.RBY1 + p.RBY4 * gamma**2) * B_kappa * p.LYKA  # 4.E62
        E_kappa = self._curvature(p.REY1 + p.REY2 * dfz)  # 4.E64
        G = _weight(c.kappa, p.RHY1 + p.RHY2 * dfz, B_kappa, p.RCY1, E_kappa)  # 4.E59-4.E61
        D_V = pure.D * (p.RVY1 + p.RVY2 * dfz + p.RVY3 * gamma)
        D_V = D_V * np.cos(np.arctan(p.RVY4 * c.alpha))  # 4.E67
        SV_kappa = D_V * np.sin(p.RVY5 * np.arctan(p.RVY6 * c.kappa)) * p.LVYKA  # 4.E66
        return _Lateral(Fy=G * pure.Fy + SV_kappa, G=G, pure=pure)  # 4.E58

    def _aligning_moment(self, c: Conditions, x: _Longitudinal, y: _Lateral) -> Array:
        p, dfz, dpi, gamma = self.parameters, c.dfz, c.dpi, c.gamma * self.parameters.LGAZ
        forward, size = np.sign(c.Vx), np.abs(gamma)
        nominal, radius = p.LFZO * p.FNOMIN, p.UNLOADED_RADIUS

        alpha_t = c.alpha + p.QHZ1 + p.QHZ2 * dfz + (p.QHZ3 + p.QHZ4 * dfz) * gamma  # 4.E34-4.E35
        alpha_r = c.alpha + y.pure.SH + y.pure.SV / y.pure.K_prime  # 4.E37-4.E38
        B = (p.QBZ1 + p.QBZ2 * dfz + p.QBZ3 * dfz**2) * (1 + p.QBZ4 * gamma + p.QBZ5 * size)
        B = B * p.LKY / c.mu_y  # 4.E40
        C = p.QCZ1  # 4.E41
        D = c.Fz * radius / nominal * (p.QDZ1 + p.QDZ2 * dfz) * (1 - p.PPZ1 * dpi)  # 4.E42
        D = D * (1 + p.QDZ3 * gamma + p.QDZ4 * gamma**2) * p.LTR * forward  # 4.E43
        E = p.QEZ1 + p.QEZ2 * dfz + p.QEZ3 * dfz**2
        side = (p.QEZ4 + p.QEZ5 * gamma) * 2 / np.pi * np.arctan(B * C * alpha_t)
        E = self._curvature(E * (1 + side))  # 4.E44
        B_r = p.QBZ9 * p.LKY / c.mu_y + p.QBZ10 * (y.pure.B * y.pure.C)  # 4.E45
        camber = (p.QDZ8 + p.QDZ9 * dfz) * (1 + p.PPZ2 * dpi) + (p.QDZ10 + p.QDZ11 * dfz) * size
        D_r = (p.QDZ6 + p.QDZ7 * dfz) * p.LRES + camber * gamma * p.LKZC
        D_r = c.Fz * radius * D_r * c.mu_y * forward * c.cosine  # 4.E47

        # QBZ4 and QDZ3 use the signed camber, as in MF-Tyre; the book uses |gamma|.
        # The book adds the longitudinal slip to the angles (4.E77-4.E78). MF-Tyre and the
        # reference values add it to their tangents.
        slip = x.K / y.pure.K_prime * c.kappa
        alpha_t = np.arctan(np.hypot(np.tan(alpha_t), slip)) * np.sign(alpha_t)
        alpha_r = np.arctan(np.hypot(np.tan(alpha_r), slip)) * np.sign(alpha_r)
        trail = D * np.cos(C * np.arctan(_argument(alpha_t, B, E))) * c.cosine  # 4.E73
        residual = D_r * np.cos(np.arctan(B_r * alpha_r))  # 4.E75
        # The force at the trail is the cambered one in MF 5.2, and the one without camber in MF 6
        # (4.E74). Longitudinal slip reduces it at the actual camber, as in the reference values.
        pure = y.pure if p.version == "5.2" else self.pure_lateral(c, 0.0 * gamma, p)
        arm = p.SSZ1 + p.SSZ2 * y.Fy / nominal + (p.SSZ3 + p.SSZ4 * dfz) * gamma
        return -trail * y.G * pure.Fy + residual + radius * arm * p.LS * x.Fx  # 4.E71-4.E76

    def _curvature(self, E: Array) -> Array:
        return np.minimum(E, 1.0) if self.clamp_curvature else E

    def faded(self, mu: Array) -> Array:
        """lambda'_mu, 4.E8."""
        return self.A_mu * mu / (1 + (self.A_mu - 1) * mu)


def _argument(slip: Array, B: Array, E: Array) -> Array:
    """Return the argument of the arctangent in the Magic Formula, B x - E (B x - arctan(B x))."""
    return B * slip - E * (B * slip - np.arctan(B * slip))


def _weight(slip: Array, shift: Any, B: Array, C: float, E: Array) -> Any:
    """Return the weight of one force by slip in the other direction, 1 without this slip."""
    at_zero = np.cos(C * np.arctan(_argument(shift, B, E)))
    return np.cos(C * np.arctan(_argument(slip + shift, B, E))) / at_zero
