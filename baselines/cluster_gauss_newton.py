"""Alias of `miho.methods.cluster_gauss_newton` for configurations and stored runs."""

from miho.methods.cluster_gauss_newton import ClusterGaussNewton

__all__ = ["ClusterGaussNewton"]
