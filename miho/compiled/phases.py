"""The phases of a bracket, of all methods whose brackets descend."""

SCREEN, RUNG, LEAD, FINISH, REVIVE, POLISH, CLOSED, EMPTY, RETURNED, SOLVED = range(10)
"""First looks at its starts; steps of a rung; more steps of the rung's best; the last candidate to
its end on all rows; a stalled candidate of an earlier bracket, which goes on; more digits for the
best of all brackets. There is none; or it has ended without an end of its last candidate: none is
left; none leads to anything new; a problem that is linear in all parameters is solved."""
UNLIMITED = 1 << 40
"""Steps of a candidate that goes on as long as it makes progress."""
