"""Phases of a bracket, of all methods whose brackets descend."""

SCREEN, RUNG, LEAD, FINISH, REVIVE, POLISH, CLOSED, EMPTY, RETURNED, SOLVED = range(10)
"""First evaluations of the starts; steps of a rung; more steps of its best; the last candidate to
its end on all rows; a stalled candidate of an earlier bracket; the final descent from the best. The
others are ends: no bracket; no candidate left; no candidate leads to a new optimum; a problem that
is linear in all parameters is solved."""
UNLIMITED = 1 << 40
"""Steps of a candidate that continues as long as it makes progress."""
