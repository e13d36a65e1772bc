"""Linear constraints between parameters, for example a < b, by a reparametrisation.

Box and constraints form a convex polytope. Fourier-Motzkin elimination (Schrijver, Theory of Linear
and Integer Programming, 1986, Ch. 12.2) gives the range of each parameter in turn as a function of
the parameters before it. A free share from 0 to 1 locates the parameter within its range, so the
search box of the shares covers the polytope exactly. The elimination of many dense inequalities
takes too long. If a range depends on too many of them, shares locate points along rays from the
centre instead (`miho.radial_map`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy  # loads its subpackages at first use: importing them takes a second

from miho.identification.constraint_text import (
    EXAMPLE,
    Constraint,
    Ends,
    Form,
    form_text,
    share_of_range,
    stated_in,
)
from miho.models.formula_parser import LONGEST
from miho.models.tied import Ties
from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.radial_map import RadialMap

THIN = 1e-9
"""A set narrower than this share of the box in some direction is empty; an inequality that removes
less than this is redundant."""
EDGE = 1e-6
"""A value closer than this share of a range to one of its ends counts as at the edge."""
SMALL = 1e-12
"""A coefficient below this share of the largest is rounding."""
MOST = 500
"""Largest number of inequalities for the elimination: the time grows with their cube."""


def constrained(space: Space, constraints: str | Sequence[str]) -> Space:
    """Restrict a space to configurations that satisfy linear constraints.

    `constraints` are chains of linear expressions, for example "a < b < c" or "a + b = 1". Each
    parameter whose range depends on others is tied to a free share, and the last parameter of an
    equation to the others. Raises ValueError for a constraint that is not linear or names no
    parameter, and if no configuration satisfies all constraints.
    """
    if not isinstance(constraints, str | Sequence):
        raise ValueError(f"constraints: {EXAMPLE}; got {constraints!r}")
    texts = [constraints] if isinstance(constraints, str) else list(constraints)
    stated = [constraint for text in texts for constraint in stated_in(space, text)]
    if not stated:
        return space
    polytope = _Polytope(space, stated)
    centre = polytope.centre()
    begin = polytope.means(centre)
    equations, sides = polytope.solved()
    changed = {
        k: [_tied(space.parameters[k], form_text(e, space.names))] for k, e in equations.items()
    }
    radial = None
    try:
        ends = polytope.eliminated(equations, sides)
        taken = {*space.names}
        for k in sorted(ends):
            changed[k] = _between(space.parameters[k], ends[k], space.names, begin, taken)
            taken.update(p.name for p in changed[k])
    except _TooLongError:
        shares = polytope.shares(equations)
        radial = polytope.radial(shares, sides, centre)
        for k, share in shares.items():
            changed[k] = [_tied(space.parameters[k], share.name), share]
    parameters = [p for k, own in enumerate(space.parameters) for p in changed.get(k, [own])]
    return replace(space, parameters=tuple(parameters), radial=radial)


def free_values(space: Space, ties: Ties | None, values: Mapping[str, float]) -> Array:
    """The free parameters (f,) that give the stated parameters these values.

    Raises ValueError for values that violate the constraints.
    """
    theta = np.array([0.0 if p.stands_for else float(values[p.name]) for p in space.parameters])
    shares = {k: p.stands_for for k, p in enumerate(space.parameters) if p.stands_for}
    if ties is None:
        return theta
    if ties.radial is not None:
        point = np.array([float(values[name]) for name in ties.radial.names])
        theta[list(shares)] = ties.radial.shares(point)
        return theta
    for k, parameter in shares.items():
        name, log = parameter.name, parameter.scale == "log"
        both = np.stack([theta, theta])
        both[:, k] = 0.0, 1.0
        low, high = ties.values(both)[:, ties.names.index(name)]
        value = float(values[name])
        if not low <= value <= high:
            raise ValueError(
                f"start: {name} is {value:g}; expected {low:.6g} to {high:.6g}, the range that the "
                "constraints allow"
            )
        if low < high:
            theta[k] = np.log(value / low) / np.log(high / low) if log else (
                (value - low) / (high - low))  # fmt: skip
    return theta


def check_within(sought: Space, own: Space, values: Mapping[str, float]) -> None:
    """Raise ValueError if the optimum is at an edge of a range that only dense constraints needed.

    Ranges of `sought` that differ from the ranges of `own` are such ranges; an end at their edge is
    no optimum.
    """
    for near, far in zip(sought.parameters, own.parameters, strict=True):
        slack = EDGE * (near.high - near.low)
        within = near.low + slack < values[near.name] < near.high - slack
        if (near.low, near.high) != (far.low, far.high) and not within:
            raise ValueError(
                f"constraints: {near.name} ends at {values[near.name]:g}, the edge of the range "
                f"from {near.low:g} to {near.high:g} about its start; give bounds"
            )


class _TooLongError(Exception):
    """The elimination of dense inequalities gives ranges that depend on too many parameters."""


class _Polytope:
    """The configurations (d,) of a space that satisfy constraints."""

    def __init__(self, space: Space, constraints: list[Constraint]) -> None:
        self._space, self._constraints = space, constraints
        used = np.any([c.form.coefficients != 0 for c in constraints], axis=0)
        self._members = np.flatnonzero(used).tolist()
        free = [p.free for p in space.parameters]
        self._low = np.where(free, space.low, 0.0)
        self._width = np.where(free, space.high, 1.0) - self._low

    def centre(self) -> Array:
        """The point (d,) farthest from all sides; raises ValueError if the polytope is empty."""
        room, centre = self._room(self._constraints)
        if room > THIN:
            return centre
        few = self._constraints
        for text in dict.fromkeys(c.text for c in few):  # a minimal set that contradicts itself
            fewer = [c for c in few if c.text != text]
            few = few if self._room(fewer)[0] > THIN else fewer
        listed = ", ".join(dict.fromkeys(c.text for c in few))
        if self._room(few, boxed=False)[0] <= THIN:
            raise ValueError(f"constraints: no values satisfy {listed}; remove one of them")
        involved = np.any([c.form.coefficients != 0 for c in few], axis=0)
        ranges = ", ".join(
            f"{p.name} from {p.low:g} to {p.high:g}"
            for p, is_involved in zip(self._space.parameters, involved, strict=True)
            if is_involved
        )
        raise ValueError(f"constraints: no values of {ranges} satisfy {listed}; widen a range")

    def means(self, centre: Array) -> Array:
        """The mean (d,) of the starting points; the centre (d,) if it violates a constraint."""
        own = [p.mean for p in self._space.parameters]
        means = np.array([c if m is None else m for c, m in zip(centre, own, strict=True)])
        at = (means - self._low) / self._width
        for constraint in self._constraints:
            form = self._scaled(constraint.form)
            room = form.offset + form.coefficients @ at
            if (-abs(room) if constraint.equal else room) < -THIN:
                return centre
        return means

    def _room(self, constraints: list[Constraint], boxed: bool = True) -> tuple[float, Array]:
        """The largest distance to all sides, in shares of the ranges, and the point (d,)."""
        d = len(self._low)
        sides = [self._scaled(c.form) for c in constraints if not c.equal]
        if boxed:
            sides += [Form(e, 0.0) for e in np.eye(d)] + [Form(-e, 1.0) for e in np.eye(d)]
        equations = [self._scaled(c.form) for c in constraints if c.equal]
        # The last unknown is the distance, at most 1, which is maximised.
        solution = scipy.optimize.linprog(
            -np.eye(d + 1)[-1],
            A_ub=np.array([[*-side.coefficients, 1.0] for side in sides]).reshape(-1, d + 1),
            b_ub=np.array([side.offset for side in sides]),
            A_eq=np.array([[*e.coefficients, 0.0] for e in equations]).reshape(-1, d + 1),
            b_eq=np.array([-equation.offset for equation in equations]),
            bounds=[(None, None)] * d + [(None, 1.0)],
        )
        if solution.x is None:
            return -1.0, self._low
        return float(solution.x[-1]), self._low + self._width * solution.x[:-1]

    def _scaled(self, form: Form) -> Form:
        """The form in shares of the ranges, scaled to a largest coefficient of 1."""
        coefficients = form.coefficients * self._width
        size = np.abs(coefficients).max()
        offset = form.offset + form.coefficients @ self._low
        return Form(coefficients / size, float(offset / size))

    def solved(self) -> tuple[dict[int, Form], list[Form]]:
        """Forms of the parameters that equations determine, by position; and inequalities."""
        sides = [c.form for c in self._constraints if not c.equal]
        for k, e in zip(self._members, np.eye(len(self._low))[self._members], strict=True):
            sides += [Form(e, -self._low[k]), Form(-e, self._low[k] + self._width[k])]
        equations: dict[int, Form] = {}
        for form in (c.form for c in self._constraints if c.equal):
            for k, known in equations.items():
                form = self._without(form, k, known)
            if form.coefficients.any():
                last = int(np.flatnonzero(form.coefficients)[-1])
                solved = form.solved_for(last)
                sides = [self._without(side, last, solved) for side in sides]
                equations = {k: self._without(f, last, solved) for k, f in equations.items()}
                equations[last] = solved
        return equations, sides

    def eliminated(self, equations: Mapping[int, Form], sides: list[Form]) -> dict[int, Ends]:
        """Bounds of the other parameters, by position; raises _TooLongError if one is too long."""
        names = self._space.names
        ends: dict[int, Ends] = {}
        for k in reversed([k for k in self._members if k not in equations]):
            if len(sides) > MOST:
                raise _TooLongError
            sides = self._necessary(sides)
            lower = [side.solved_for(k) for side in sides if side.coefficients[k] > 0]
            upper = [side.solved_for(k) for side in sides if side.coefficients[k] < 0]
            ends[k] = lower, upper
            if len(share_of_range(self._space.parameters[k], ends[k], names, "")) > LONGEST:
                raise _TooLongError
            sides = [side for side in sides if side.coefficients[k] == 0]
            sides += [self._clean(high.minus(low)) for low in lower for high in upper]
        return ends

    def shares(self, equations: Mapping[int, Form]) -> dict[int, Parameter]:
        """Shares of a radial map, by position, for parameters that no equation determines."""
        shares: dict[int, Parameter] = {}
        for k in (k for k in self._members if k not in equations):
            parameter = self._space.parameters[k]
            name = _share_name(parameter, {*self._space.names, *(p.name for p in shares.values())})
            shares[k] = Parameter(name, "-", -1.0, 1.0, stands_for=parameter)
        return shares

    def radial(
        self, shares: Mapping[int, Parameter], sides: Sequence[Form], centre: Array
    ) -> RadialMap:
        """The map along rays from the centre (d,) to points that satisfy all inequalities."""
        places = list(shares)
        rooms = np.array([side.offset + side.coefficients @ centre for side in sides])
        slopes = np.stack([side.coefficients[places] * self._width[places] for side in sides])
        named = [c.text for c in self._constraints if not c.equal]
        return RadialMap(
            tuple(self._space.names[k] for k in places),
            tuple(share.name for share in shares.values()),
            centre[places],
            self._width[places],
            -slopes / rooms[:, None],
            (*named, *["the ranges"] * (len(sides) - len(named))),
            self._space.low[places],
            self._space.high[places],
        )

    def _without(self, form: Form, k: int, value: Form) -> Form:
        """The form with `value` substituted for parameter k."""
        factor = form.coefficients[k]
        coefficients = form.coefficients + factor * value.coefficients
        coefficients[k] = 0.0
        return self._clean(Form(coefficients, form.offset + factor * value.offset))

    def _clean(self, form: Form) -> Form:
        """A form with rounding errors among its coefficients set to 0."""
        size = np.abs(form.coefficients * self._width)
        return form._replace(
            coefficients=np.where(size > SMALL * size.max(), form.coefficients, 0.0)
        )

    def _necessary(self, sides: list[Form]) -> list[Form]:
        """The inequalities that are not redundant."""
        necessary = [side for side in sides if side.coefficients.any()]
        for side in list(necessary):
            others = [self._scaled(other) for other in necessary if other is not side]
            own = self._scaled(side)
            if not others:
                continue
            least = scipy.optimize.linprog(
                own.coefficients,
                A_ub=np.array([-other.coefficients for other in others]),
                b_ub=np.array([other.offset for other in others]),
                bounds=(None, None),
            )
            if least.fun is not None and least.fun + own.offset > -THIN:
                necessary = [other for other in necessary if other is not side]
        return necessary


def _tied(parameter: Parameter, expression: str) -> Parameter:
    """The parameter tied to an expression, without a range."""
    return replace(
        parameter, low=-np.inf, high=np.inf, mean=None, std=None, sigma_max=None, sigma_min=0.0,
        tied=expression,
    )  # fmt: skip


def _between(
    parameter: Parameter, ends: Ends, names: Sequence[str], begin: Array, taken: set[str]
) -> list[Parameter]:
    """A parameter within bounds; if these vary, it is tied to a share of its range.

    Starting points are drawn about `begin` (d,).
    """
    lower, upper = ends
    log, at = parameter.scale == "log", float(begin[names.index(parameter.name)])
    low, high = (
        choose(form.offset + form.coefficients @ begin for form in side)
        for choose, side in ((max, lower), (min, upper))
    )
    if not any(form.coefficients.any() for form in lower + upper):
        mean = at if parameter.mean is None and not log else parameter.mean
        inside = mean is None or low <= mean <= high
        return [replace(parameter, low=float(low), high=float(high), mean=mean if inside else None)]
    name = _share_name(parameter, taken)
    expression = share_of_range(parameter, ends, names, name)
    mean = std = None
    width = np.log(high / low) if log else high - low
    if width > 0 and not (log and parameter.mean is None):
        mean = float(np.clip((np.log(at / low) if log else at - low) / width, 0.0, 1.0))
        std = None if parameter.std is None else float(parameter.std / width)
    share = Parameter(name, "-", 0.0, 1.0, mean=mean, std=std, stands_for=parameter)
    return [_tied(parameter, expression), share]


def _share_name(parameter: Parameter, taken: set[str]) -> str:
    """An unused name for the share of a parameter."""
    name = f"{parameter.name}_share"
    while name in taken:
        name += "_"
    return name
