"""Parametric models: pure functions of inputs and a batch of parameters."""

from miho.models.model import Model
from miho.models.tir import TirError, load_tir
from miho.models.tire import Pacejka

__all__ = ["Model", "Pacejka", "TirError", "load_tir"]
