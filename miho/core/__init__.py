"""Formulas as tapes of operations, and the machine that runs them.

Below all other rooms: it knows arrays, no graph and no model. The machine is C, built when the
library is installed; NumPy's form of it gives the same to rounding. It also searches formulas, by
the brackets of `MIHOGN`, whose Python form is that of `miho.compiled`, and makes thousands of small
fits of a formula.
"""

from miho.core.tape import OPERATIONS, Instruction, Tape, TapeError, machine

__all__ = ["OPERATIONS", "Instruction", "Tape", "TapeError", "machine"]
