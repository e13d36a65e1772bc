"""Fits in one call: one dataset, several datasets jointly, or many datasets one by one."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.fitting.fit_result import Fit, Prediction
    from miho.fitting.joint_fit import JointFit, Part, fit_joint
    from miho.fitting.many_fits import fit_many
    from miho.fitting.one_fit import fit

__all__ = ["Fit", "JointFit", "Part", "Prediction", "fit", "fit_joint", "fit_many"]

__getattr__, __dir__ = at_first_use(__name__)
