"""Parametric models: pure functions of inputs and a batch of parameters."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.models.fmu import FmuModel
    from miho.models.function_model import FunctionModel
    from miho.models.identified import Identified, OutsideDataWarning, read_parameters
    from miho.models.model import Model
    from miho.models.trajectory import Trajectory
    from miho.models.user_file import load_function, load_trajectory

__all__ = [
    "FmuModel", "FunctionModel", "Identified", "Model", "OutsideDataWarning", "Trajectory",
    "load_function", "load_trajectory", "read_parameters",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
