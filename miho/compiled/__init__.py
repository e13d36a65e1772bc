"""Fast forms of losses, and the two doors to them: `kernel_for`, and `taped_loss`.

Below all other rooms: it knows arrays and formulas, no problem, space or model class. What stands
here is not needed to read anything else: each fast form gives what plain NumPy gives.
"""

from miho.compiled.kernel import Block, Climb, Kernel, Rows, Steps, kernel_for, taped_loss

__all__ = ["Block", "Climb", "Kernel", "Rows", "Steps", "kernel_for", "taped_loss"]
