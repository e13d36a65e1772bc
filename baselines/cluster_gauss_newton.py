"""`miho.methods.cluster_gauss_newton` under the name that configurations and stored runs know."""

from miho.methods.cluster_gauss_newton import ClusterGaussNewton

__all__ = ["ClusterGaussNewton"]
