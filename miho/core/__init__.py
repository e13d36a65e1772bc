"""Formulas as tapes of operations, and the machine that runs them.

This package knows arrays, but no graph and no model. The machine is written in C and built with the
library; a NumPy form gives the same results up to rounding. The machine also searches with formulas
by the brackets of `MIHOGN`, whose Python form is in `miho.compiled`, and makes thousands of small
fits of a formula.
"""

from miho.core.tape import OPERATIONS, Instruction, Tape, TapeError, machine

__all__ = ["OPERATIONS", "Instruction", "Tape", "TapeError", "machine"]
