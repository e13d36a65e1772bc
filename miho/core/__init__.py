"""Formulas that run without being compiled: tapes of operations, and the machine that runs them.

Below all other rooms: it knows arrays, no graph and no model. The machine is C, built when the
library is installed; NumPy's form of it gives the same to rounding.
"""

from miho.core.tape import OPERATIONS, Instruction, Tape, TapeError, machine

__all__ = ["OPERATIONS", "Instruction", "Tape", "TapeError", "machine"]
