"""Fast forms of losses; use them through `kernel_for` and `taped_loss`.

This package knows arrays and formulas, but no problem, space or model class. Every fast form gives
the same results as plain NumPy.
"""

from miho.compiled.kernel import Block, Climb, Kernel, Rows, Steps, kernel_for, taped_loss

__all__ = ["Block", "Climb", "Kernel", "Rows", "Steps", "kernel_for", "taped_loss"]
