"""Methods that need only NumPy and SciPy, and all forms of MIHO, in one namespace.

Methods that wrap another library are in `baselines` of the checkout.
"""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.methods.cluster_gauss_newton import ClusterGaussNewton
    from miho.methods.differential_evolution import DifferentialEvolution
    from miho.methods.dual_annealing import DualAnnealing
    from miho.methods.gbo import GBO
    from miho.methods.hickernell_yuan import HickernellYuan
    from miho.methods.hyperband import Hyperband, SuccessiveHalving
    from miho.methods.least_squares import LeastSquares
    from miho.methods.local_search import LBFGSB, NelderMead
    from miho.methods.pso import PSO
    from miho.methods.scatter_search import ScatterSearch
    from miho.methods.tiktak import TikTak
    from miho.methods.variable_projection import VariableProjection
    from miho.optim import MIHO, MIHOGN, MIHOQN, RandomSearch

__all__ = [
    "GBO", "LBFGSB", "MIHO", "MIHOGN", "MIHOQN", "PSO", "ClusterGaussNewton",
    "DifferentialEvolution", "DualAnnealing", "HickernellYuan", "Hyperband", "LeastSquares",
    "NelderMead", "RandomSearch", "ScatterSearch", "SuccessiveHalving", "TikTak",
    "VariableProjection",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
