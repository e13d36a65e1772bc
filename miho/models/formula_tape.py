"""Compilation of graphs to tapes for the machine of `miho.core`.

Equal operations are evaluated once, and operations on parameters only are evaluated once for all
rows. A register is reused after the last read of its content (linear scan register allocation;
Poletto and Sarkar 1999).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from miho.core import Instruction, Tape, TapeError
from miho.core.tape import HUGE, TINY
from miho.models.symbolic import (
    CONSTANT,
    NotAFormulaError,
    Symbol,
    argument,
    of_symbols,
    operation,
    ordered,
    trace,
)

PLAIN = {
    "add": "ADD", "subtract": "SUB", "divide": "DIV", "multiply": "MUL", "negative": "NEG",
    "positive": "COPY", "absolute": "ABS", "sign": "SIGN", "sqrt": "SQRT", "minimum": "MIN",
    "maximum": "MAX", "exp": "EXP", "expm1": "EXPM1", "log": "LOG", "log1p": "LOG1P",
    "log10": "LOG10", "log2": "LOG2", "tan": "TAN", "arcsin": "ASIN", "arccos": "ACOS",
    "arctan": "ATAN", "arctan2": "ATAN2", "hypot": "HYPOT", "sinh": "SINH", "cosh": "COSH",
    "tanh": "TANH", "arcsinh": "ASINH", "arccosh": "ACOSH", "arctanh": "ATANH", "greater": "GT",
    "greater_equal": "GE", "less": "LT", "less_equal": "LE", "equal": "EQ", "not_equal": "NE",
    "logical_and": "AND", "logical_or": "OR", "logical_not": "NOT", "where": "WHERE",
}  # fmt: skip
"""Graph operations with one machine operation; sine, cosine and powers are separate."""
EITHER_WAY = {"ADD", "MUL", "EQ", "NE", "AND", "OR"}
WITH_SCALAR = {"ADD", "SUB", "MUL", "DIV"}
TWO_RESULTS = {"LOG_PARTS", "FLOOR_PARTS"}
CONSTANTS, PARAMETERS, INPUTS, SECOND = "constant", "parameter", "input", "second result"
LEAVES = (CONSTANTS, PARAMETERS, INPUTS)
LARGEST_POWER = 64
"""Largest integer exponent that is expanded into multiplications."""


def tape_of(
    results: Sequence[Symbol],
    columns: Sequence[Symbol],
    parameters: Sequence[Symbol],
    abreast: bool = False,
) -> Tape:
    """Return the tape that computes results from input columns and parameters.

    If `abreast`, operations are sorted by depth, so that neighbours are independent. This needs
    more registers, and is faster for few rows, because the processor does not wait for results.
    """
    nodes = _Nodes()
    at = {symbol: nodes.add(INPUTS, k) for k, symbol in enumerate(columns)}
    at |= {symbol: nodes.add(PARAMETERS, k) for k, symbol in enumerate(parameters)}
    for symbol in ordered(results):
        if symbol not in at:
            at[symbol] = nodes.of_symbol(symbol, at)
    return _Registers(nodes, [at[r] for r in results], len(columns), len(parameters)).tape(abreast)


def traced_tapes(
    value: Callable[..., Any], derivatives: Callable[..., Any], p: int, d: int
) -> tuple[Tape, Tape] | None:
    """Return the tapes of a formula with p inputs and d parameters, and of its d derivatives.

    The result is None if they cannot be traced, or are too long for the machine.
    """
    tapes = _traced(value, derivatives, p, d, lambda graph, slopes: ([graph], slopes))
    return None if tapes is None else (tapes[0], tapes[1])


def traced_together(
    value: Callable[..., Any], derivatives: Callable[..., Any], p: int, d: int
) -> Tape | None:
    """Return one tape of the d derivatives of a formula followed by its value.

    The result is None if they cannot be traced, or are too long for the machine.
    """
    tapes = _traced(value, derivatives, p, d, lambda graph, slopes: ([*slopes, graph],))
    return None if tapes is None else tapes[0]


def _traced(
    value: Callable[..., Any],
    derivatives: Callable[..., Any],
    p: int,
    d: int,
    parts: Callable[[Symbol, list[Symbol]], Sequence[Sequence[Symbol]]],
) -> list[Tape] | None:
    """Return a tape for each group of results that `parts` makes of value and derivatives."""
    columns = tuple(argument(f"x{k}") for k in range(p))
    parameters = tuple(argument(f"p{k}") for k in range(d))
    try:
        graph = trace(value, columns, parameters)
        slopes = of_symbols(
            lambda: [operation("positive", slope) for slope in derivatives(columns, parameters)]
        )
        tapes = [tape_of(results, columns, parameters) for results in parts(graph, slopes)]
        _ = [tape.in_machine for tape in tapes]
    except (NotAFormulaError, TapeError):
        return None
    return tapes if len(slopes) == d else None


class _Nodes:
    """The machine operations of a graph, without duplicates.

    A node is a name with the nodes that it reads; a leaf is a name with its number. The node of an
    operation with two results is the first result, and a SECOND node is the other one.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple[str, tuple[float, ...]]] = []
        self.uniform: list[bool] = []  # equal for all rows
        self._known: dict[tuple[object, ...], int] = {}

    def add(self, name: str, *operands: float) -> int:
        """Return the node, which is added if it is new."""
        if name in EITHER_WAY:
            operands = tuple(sorted(operands))
        if name == "MUL" and operands[0] == operands[1]:
            name, operands = "SQUARE", operands[:1]
        # The text distinguishes 0.0 from -0.0, and NaN equals NaN.
        key = (name, repr(operands[0])) if name == CONSTANTS else (name, *operands)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append((name, operands))
            leaf = name in LEAVES
            self.uniform.append(
                name != INPUTS and (leaf or all(self.uniform[int(k)] for k in operands))
            )
        return self._known[key]

    def operands(self, node: int) -> tuple[int, ...]:
        """Return the nodes that a node reads."""
        name, operands = self.nodes[node]
        return () if name in LEAVES else tuple(map(int, operands))

    def of_symbol(self, symbol: Symbol, at: Mapping[Symbol, int]) -> int:
        """Return the node of an operation, given the nodes `at` of its arguments."""
        if symbol.operation == CONSTANT:
            return self.add(CONSTANTS, symbol.arguments[0])
        name, arguments = symbol.operation, symbol.arguments
        operands = [at[argument] for argument in arguments]
        if name == "sin":
            return self.add("SINCOS", *operands)
        if name == "cos":
            return self.add(SECOND, self.add("SINCOS", *operands))
        if name == "power":
            exponent = arguments[1].number
            if exponent is not None and exponent.is_integer() and abs(exponent) <= LARGEST_POWER:
                return self._multiplied_out(operands[0], int(exponent))
            high, low = self._log_parts(arguments[0], at)
            return self.add("POWER", *operands, high, low)
        if name == "log" and _floored(arguments[0]) is not None:
            return self._log_parts(arguments[0], at)[0]
        if name == "minimum" and arguments[1].number == HUGE:
            inner = arguments[0]
            if inner.operation == "maximum" and inner.arguments[1].number == -HUGE:
                return self.add("BOUND", at[inner.arguments[0]])
        return self.add(PLAIN[name], *operands)

    def _log_parts(self, base: Symbol, at: Mapping[Symbol, int]) -> tuple[int, int]:
        """Return the parts of the logarithm of |base|, shared by a power and its derivatives."""
        floored = _floored(base)
        parts = self.add("LOG_PARTS", at[base if floored is None else floored])
        low = self.add(SECOND, parts)
        if floored is None:
            return parts, low
        above = self.add("FLOOR_PARTS", parts, low)
        return above, self.add(SECOND, above)

    def _multiplied_out(self, base: int, exponent: int) -> int:
        """Return the node of an integer power, by repeated squaring."""
        if exponent <= 0:
            unity = self.add(CONSTANTS, 1.0)
            if not exponent:
                return unity
            return self.add("DIV", unity, self._multiplied_out(base, -exponent))
        if exponent == 1:
            return base
        half = self._multiplied_out(base, exponent // 2)
        square = self.add("MUL", half, half)
        return self.add("MUL", square, base) if exponent % 2 else square

    def needed_for(self, results: Sequence[int]) -> list[int]:
        """Return the nodes under results in topological order."""
        needed, stack = set[int](), list(results)
        while stack:
            node = stack.pop()
            if node not in needed:
                needed.add(node)
                stack += self.operands(node)
                if self.nodes[node][0] in TWO_RESULTS:
                    stack.append(self.add(SECOND, node))
        return sorted(needed)


def _floored(symbol: Symbol) -> Symbol | None:
    """Return x for max(|x|, TINY), which occurs in derivatives of powers; otherwise None."""
    if symbol.operation != "maximum" or symbol.arguments[1].number != TINY:
        return None
    inner: Symbol = symbol.arguments[0]
    return inner.arguments[0] if inner.operation == "absolute" else None


class _Registers:
    """Assignment of nodes to scalars and registers."""

    def __init__(self, nodes: _Nodes, results: Sequence[int], inputs: int, parameters: int) -> None:
        self.nodes, self.results = nodes, results
        self.inputs, self.parameters = inputs, parameters
        self.needed = nodes.needed_for(results)
        self.base = self.top = inputs + len(results)
        self.free: list[int] = []
        self.fills: dict[int, int] = {}  # registers of scalars, by node
        names = nodes.nodes
        constants = [k for k in self.needed if names[k][0] == CONSTANTS]
        self.constants = tuple(names[k][1][0] for k in constants)
        self.scalars = {k: i for i, k in enumerate(constants)}
        for k, (name, operands) in enumerate(names):
            if name == PARAMETERS:
                self.scalars[k] = len(constants) + int(operands[0])
        self.count = len(constants) + parameters
        self.at = {k: int(operands[0]) for k, (name, operands) in enumerate(names)
                   if name == INPUTS}  # fmt: skip
        self.slots: dict[int, int] = {}  # results that are written to their final registers
        for i, k in enumerate(results):
            if not nodes.uniform[k] and k not in self.at:
                self.slots.setdefault(k, inputs + i)
        self.users: dict[int, list[int]] = {}
        for k in self.needed:
            for operand in nodes.operands(k):
                self.users.setdefault(operand, []).append(k)

    def tape(self, abreast: bool) -> Tape:
        """Return the tape; see `tape_of`."""
        nodes = self.nodes
        once = tuple(self._once())
        rows = [k for k in self.needed if not nodes.uniform[k] and k not in self.at]
        if abreast:
            depth = dict.fromkeys(self.needed, 0)
            for k in self.needed:
                depth[k] = max((depth[j] + 1 for j in nodes.operands(k)), default=0)
            rows.sort(key=depth.__getitem__)
        code = [*self._rows([k for k in rows if nodes.nodes[k][0] != SECOND])]
        for i, k in enumerate(self.results):
            if self.slots.get(k) != self.inputs + i:
                code.append(Instruction("COPY", (self._register_of(k),), (self.inputs + i,)))
        fills = tuple((register, self.scalars[k]) for k, register in self.fills.items())
        return Tape(
            self.inputs, len(self.results), self.top, self.parameters, self.count, self.constants,
            once, tuple(code), fills,
        )  # fmt: skip

    def _once(self) -> Iterator[Instruction]:
        """Yield the instructions that are evaluated once for all rows."""
        for k in self.needed:
            if not self.nodes.uniform[k] or k in self.scalars:
                continue
            name, outputs = self._operation(k)
            for node in outputs:
                self.scalars[node] = self.count
                self.count += 1
            operands = tuple(self.scalars[j] for j in self.nodes.operands(k))
            yield Instruction(name, operands, tuple(self.scalars[j] for j in outputs))

    def _rows(self, order: Sequence[int]) -> Iterator[Instruction]:
        """Yield the instructions that are evaluated for each row."""
        last: dict[int, int] = {}
        for i, k in enumerate(order):
            last |= dict.fromkeys(self.nodes.operands(k), i)
        for i, k in enumerate(order):
            name, outputs = self._operation(k)
            read = self.nodes.operands(k)
            operation, operands = self._read(name, read)
            done = [j for j in dict.fromkeys(read) if last[j] == i and not self.nodes.uniform[j]]
            if len(outputs) == 1:  # a single result may overwrite an operand
                self._release(done)
            places = tuple(map(self._placed, outputs))
            if len(outputs) > 1:
                self._release(done + [j for j in outputs if j not in last])
            yield Instruction(operation, operands, places)

    def _operation(self, k: int) -> tuple[str, list[int]]:
        """Return the operation of a node and the nodes that it computes, with a second result.

        SINCOS becomes SIN or COS if only one of the two is needed.
        """
        name = self.nodes.nodes[k][0]
        users = self.users.get(k, [])
        second = [j for j in users if self.nodes.nodes[j][0] == SECOND]
        if name == "SINCOS" and not second:
            return "SIN", [k]
        if name == "SINCOS" and users == second and k not in self.results:
            return "COS", second
        return name, [k, *second]

    def _read(self, name: str, read: Sequence[int]) -> tuple[str, tuple[int, ...]]:
        """Return an operation and its operands, in the form with a scalar if there is one."""
        uniform = [self.nodes.uniform[j] for j in read]
        if name not in WITH_SCALAR or not any(uniform):
            return name, tuple(map(self._register_of, read))
        row, scalar = (read[0], read[1]) if uniform[1] else (read[1], read[0])
        form = f"{name}_S" if uniform[1] or name in EITHER_WAY else f"S_{name}"
        return form, (self.at[row], self.scalars[scalar])

    def _register_of(self, k: int) -> int:
        """Return the register of a node, filled from its scalar if necessary."""
        if not self.nodes.uniform[k]:
            return self.at[k]
        if k not in self.fills:
            self.fills[k] = self._new()
        return self.fills[k]

    def _placed(self, k: int) -> int:
        self.at[k] = (
            self.slots[k] if k in self.slots else self.free.pop() if self.free else self._new()
        )
        return self.at[k]

    def _new(self) -> int:
        self.top += 1
        return self.top - 1

    def _release(self, done: Sequence[int]) -> None:
        self.free += [self.at[j] for j in done if self.at[j] >= self.base and j not in self.slots]
