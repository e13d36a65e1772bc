"""Linear constraints between parameters, such as a < b, by a reparametrisation.

Box and constraints are a convex polytope. Fourier-Motzkin elimination (Schrijver, Theory of Linear
and Integer Programming, 1986, Ch. 12.2) gives for each parameter in turn the ends between which it
can be when those before it have their values; a free share, from 0 to 1, says where between them it
is. So the whole set is searched and nothing else, as a box. The elimination of many dense
inequalities has no end: where one range depends on too many of them, shares stand for the points
along rays from the centre instead (`miho.radial_map`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy  # which loads its packages where they are used: importing them takes a second

from miho.models.formula_text import written
from miho.models.symbolic import Symbol, argument, constant, gradient
from miho.models.tied import LONGEST, Ties, parsed
from miho.optim.space import Parameter, Space
from miho.quantities import Array
from miho.radial_map import RadialMap

RELATION = re.compile(r"(<=|>=|==|<|>|=)")
EXAMPLE = "give such as 'a < b < c', 'a + b = 1' or 'b - a < 5'"
THIN = 1e-9
"""A set that is narrower than this share of the box in some direction is empty; a row that cuts
less than this off it is superfluous."""
SMALL = 1e-12
"""A coefficient below this share of the largest is rounding."""
MOST = 500
"""Inequalities at most that are eliminated: the time grows with their cube."""


class Form(NamedTuple):
    """coefficients (d,) @ theta + offset."""

    coefficients: Array
    offset: float

    def minus(self, other: Form) -> Form:
        """The difference."""
        return Form(self.coefficients - other.coefficients, self.offset - other.offset)

    def solved_for(self, k: int) -> Form:
        """What parameter k is where this is 0."""
        others = self.coefficients.copy()
        others[k] = 0.0
        return Form(-others / self.coefficients[k], -self.offset / self.coefficients[k])


class Constraint(NamedTuple):
    """A form that is at least 0, or 0 where `equal`, as `text` says."""

    form: Form
    equal: bool
    text: str


Ends = tuple[list[Form], list[Form]]
"""Forms that a parameter is at least, and that it is at most."""


def constrained(space: Space, constraints: str | Sequence[str]) -> Space:
    """The space of configurations that keep `constraints` too, such as "a < b < c" or "a + b = 1".

    Each is a chain of linear expressions. A parameter whose range depends on the others' is
    tied to a free share behind it, which stands for it; the last one of an equation is tied to the
    others. Raises ValueError for what is not linear, names no parameter, or leaves nothing.
    """
    if not isinstance(constraints, str | Sequence):
        raise ValueError(f"constraints: {constraints!r} is none; {EXAMPLE}")
    texts = [constraints] if isinstance(constraints, str) else list(constraints)
    stated = [constraint for text in texts for constraint in _stated(space, text)]
    if not stated:
        return space
    polytope = _Polytope(space, stated)
    centre = polytope.centre()
    begin = polytope.means(centre)
    equations, sides = polytope.solved()
    changed = {k: [_tied(space.parameters[k], _text(e, space.names))] for k, e in equations.items()}
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


def free_values(space: Space, ties: Ties, values: Mapping[str, float]) -> Array:
    """The free parameters (f,) at which those that shares stand for have these values.

    Raises ValueError for values that do not keep the constraints.
    """
    theta = np.array([0.0 if p.stands_for else float(values[p.name]) for p in space.parameters])
    shares = {k: p.stands_for for k, p in enumerate(space.parameters) if p.stands_for}
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
                f"start: {name} is {value:g}, and the constraints leave {low:.6g} to {high:.6g}"
            )
        if low < high:
            theta[k] = np.log(value / low) / np.log(high / low) if log else (
                (value - low) / (high - low))  # fmt: skip
    return theta


def _stated(space: Space, text: str) -> list[Constraint]:
    """The constraints of one chain."""
    parts = RELATION.split(text) if isinstance(text, str) else []
    if len(parts) < 3 or not all(part.strip() for part in parts):
        raise ValueError(f"constraints: {text!r} is none; {EXAMPLE}")
    forms = [_form(space, part.strip()) for part in parts[::2]]
    stated = []
    for left, relation, right in zip(forms, parts[1::2], forms[1:], strict=False):
        form = left.minus(right) if relation in (">", ">=") else right.minus(left)
        if not form.coefficients.any():
            raise ValueError(f"constraints: {text!r} has a part without free parameters")
        stated.append(Constraint(form, relation in ("=", "=="), text))
    return stated


def _form(space: Space, text: str) -> Form:
    """An expression as a linear form of the free parameters."""
    places = [f"p{k}" for k in range(len(space))]
    symbols: dict[str, Symbol] = {}
    for place, parameter in zip(places, space.parameters, strict=True):
        fixed = parameter.fixed
        symbols[parameter.name] = argument(place) if fixed is None else constant(fixed)
    graph = parsed(text, "constraints", symbols, symbols.__getitem__)
    slopes = [slope.number for slope in gradient(graph, [argument(place) for place in places])]
    if None in slopes or not np.isfinite(np.array(slopes, dtype=float)).all():
        raise ValueError(f"constraints: {text!r} is not linear; tie a parameter to others instead")
    coefficients = np.array(slopes, dtype=float)
    for k in np.flatnonzero(coefficients):
        if space.parameters[k].tied is not None:
            raise ValueError(
                f"constraints: {text!r} has {space.names[k]}, which is tied to "
                f"{space.parameters[k].tied!r}; write that instead"
            )
    value = written("value", {"theta": places}, [graph], single=True)
    return Form(coefficients, float(value((0.0,) * len(space))))


class _TooLongError(Exception):
    """The elimination of dense inequalities leaves ranges that depend on too much."""


class _Polytope:
    """Those configurations (d,) of a space that keep constraints."""

    def __init__(self, space: Space, constraints: list[Constraint]) -> None:
        self._space, self._constraints = space, constraints
        used = np.any([c.form.coefficients != 0 for c in constraints], axis=0)
        self._members = np.flatnonzero(used).tolist()
        free = [p.free for p in space.parameters]  # others have no part
        self._low = np.where(free, space.low, 0.0)
        self._width = np.where(free, space.high, 1.0) - self._low

    def centre(self) -> Array:
        """The point (d,) farthest from all sides; raises ValueError where there is no room."""
        room, centre = self._room(self._constraints)
        if room > THIN:
            return centre
        few = self._constraints
        for text in dict.fromkeys(c.text for c in few):  # as few as leave nothing
            fewer = [c for c in few if c.text != text]
            few = few if self._room(fewer)[0] > THIN else fewer
        listed = ", ".join(dict.fromkeys(c.text for c in few))
        if self._room(few, boxed=False)[0] <= THIN:
            raise ValueError(f"constraints: no values keep {listed}; leave one out")
        involved = np.any([c.form.coefficients != 0 for c in few], axis=0)
        ranges = ", ".join(
            f"{p.name} from {p.low:g} to {p.high:g}"
            for p, is_involved in zip(self._space.parameters, involved, strict=True)
            if is_involved
        )
        raise ValueError(f"constraints: {listed} leaves nothing of {ranges}; widen a range")

    def means(self, centre: Array) -> Array:
        """Where searches start in the mean (d,); the centre (d,) if that does not keep all."""
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
        # The last unknown is the distance, at most 1, which is to be as large as possible.
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
        """Of shares of the ranges, with 1 as its largest coefficient."""
        coefficients = form.coefficients * self._width
        size = np.abs(coefficients).max()
        offset = form.offset + form.coefficients @ self._low
        return Form(coefficients / size, float(offset / size))

    def solved(self) -> tuple[dict[int, Form], list[Form]]:
        """Linear forms that equations give parameters, by position; and forms that stay above 0."""
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
        """By position, between what the others are; raises _TooLongError where that is too long."""
        names = self._space.names
        ends: dict[int, Ends] = {}
        for k in reversed([k for k in self._members if k not in equations]):
            if len(sides) > MOST:
                raise _TooLongError
            sides = self._necessary(sides)
            lower = [side.solved_for(k) for side in sides if side.coefficients[k] > 0]
            upper = [side.solved_for(k) for side in sides if side.coefficients[k] < 0]
            ends[k] = lower, upper
            if len(_expression(self._space.parameters[k], ends[k], names, "")) > LONGEST:
                raise _TooLongError
            sides = [side for side in sides if side.coefficients[k] == 0]
            sides += [self._clean(high.minus(low)) for low in lower for high in upper]
        return ends

    def shares(self, equations: Mapping[int, Form]) -> dict[int, Parameter]:
        """By position, the shares of a radial map that stand for what no equation gives."""
        shares: dict[int, Parameter] = {}
        for k in (k for k in self._members if k not in equations):
            parameter = self._space.parameters[k]
            name = _share_name(parameter, {*self._space.names, *(p.name for p in shares.values())})
            shares[k] = Parameter(name, "-", -1.0, 1.0, stands_for=parameter)
        return shares

    def radial(
        self, shares: Mapping[int, Parameter], sides: Sequence[Form], centre: Array
    ) -> RadialMap:
        """The points along rays from the centre (d,) that keep the sides."""
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
        """A form with the value of parameter k put in."""
        factor = form.coefficients[k]
        coefficients = form.coefficients + factor * value.coefficients
        coefficients[k] = 0.0
        return self._clean(Form(coefficients, form.offset + factor * value.offset))

    def _clean(self, form: Form) -> Form:
        """A form without coefficients that are rounding."""
        size = np.abs(form.coefficients * self._width)
        return form._replace(
            coefficients=np.where(size > SMALL * size.max(), form.coefficients, 0.0)
        )

    def _necessary(self, sides: list[Form]) -> list[Form]:
        """Those without which the set were larger."""
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
    """A parameter that is tied, without a range of its own."""
    return replace(
        parameter, low=-np.inf, high=np.inf, mean=None, std=None, sigma_max=None, sigma_min=0.0,
        tied=expression,
    )  # fmt: skip


def _between(
    parameter: Parameter, ends: Ends, names: Sequence[str], begin: Array, taken: set[str]
) -> list[Parameter]:
    """A parameter between ends, tied to a share of what lies between them where those vary.

    Searches start about `begin` (d,), where the parameter has its `mean`, if it has one.
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
    expression = _expression(parameter, ends, names, name)
    mean = std = None
    width = np.log(high / low) if log else high - low
    if width > 0 and not (log and parameter.mean is None):
        mean = float(np.clip((np.log(at / low) if log else at - low) / width, 0.0, 1.0))
        std = None if parameter.std is None else float(parameter.std / width)
    share = Parameter(name, "-", 0.0, 1.0, mean=mean, std=std, stands_for=parameter)
    return [_tied(parameter, expression), share]


def _share_name(parameter: Parameter, taken: set[str]) -> str:
    """A name for the share that stands for a parameter."""
    name = f"{parameter.name}_share"
    while name in taken:
        name += "_"
    return name


def _expression(parameter: Parameter, ends: Ends, names: Sequence[str], share: str) -> str:
    """A parameter that is a share of the way between its ends."""
    lower, upper = ends
    first, last = _extreme("max", lower, names), _extreme("min", upper, names)
    if parameter.scale == "log":
        return f"{_grouped(first)} * ({_grouped(last)} / {_grouped(first)}) ** {share}"
    width = f"{last} - {_grouped(first)}" if first != "0" else last
    if len(lower) == len(upper) == 1:
        width = _text(upper[0].minus(lower[0]), names)
    expression = f"{_grouped(width)} * {share}"
    return f"{first} + {expression}" if first != "0" else expression


def _extreme(function: str, forms: Sequence[Form], names: Sequence[str]) -> str:
    """The largest or smallest of forms, as an expression."""
    text = _text(forms[0], names)
    for form in forms[1:]:
        text = f"{function}({text}, {_text(form, names)})"
    return text


def _grouped(text: str) -> str:
    """An expression in parentheses, unless it is one name or number."""
    return text if re.fullmatch(r"[\w.]+", text) else f"({text})"


def _text(form: Form, names: Sequence[str]) -> str:
    """A form as an expression, what is added first."""
    terms = [(float(a), name) for a, name in zip(form.coefficients, names, strict=True) if a]
    if form.offset or not terms:
        terms.append((float(form.offset), ""))
    text = ""
    for number, name in sorted(terms, key=lambda term: (term[0] < 0, not term[1])):
        size = f"{abs(number):.15g}"
        body = size if not name else name if size == "1" else f"{size} * {name}"
        text += f" {'-' if number < 0 else '+'} {body}" if text else "-" * (number < 0) + body
    return text
