"""Static check that a function in a file consists of arithmetic only.

The function is not called, and an allow-list decides. A function that counts its calls, reads a
file or ends the process is therefore never called to find out what it computes.
"""

from __future__ import annotations

import ast
import math
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np

from miho.regular_file import read_regular

SYNTAX = (
    ast.Return, ast.Assign, ast.AugAssign, ast.Expr, ast.If, ast.IfExp, ast.BinOp, ast.UnaryOp,
    ast.BoolOp, ast.Compare, ast.Constant, ast.Tuple, ast.Name, ast.Attribute, ast.Call,
    ast.keyword, ast.expr_context, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
"""Allowed syntax, without loops and with assignments to local variables only."""
OTHERS = (abs, np.where, np.clip)
NUMBERS = (bool, int, float, np.float64)
"""Allowed types of constants; subclasses may redefine arithmetic and are not allowed."""


def is_arithmetic(function: Any, callers: tuple[FunctionType, ...] = ()) -> bool:
    """Return whether a function is arithmetic on arguments and numbers.

    It may call functions of NumPy and math, and other arithmetic functions. `callers` are the
    functions that call it; it may not call them again.
    """
    if not isinstance(function, FunctionType) or function in callers:
        return False
    definition = _definition(function)
    if definition is None or definition.decorator_list:
        return False
    nodes = [node for statement in definition.body for node in ast.walk(statement)]
    names = [node for node in nodes if isinstance(node, ast.Name)]
    attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
    if any(not isinstance(attribute.ctx, ast.Load) for attribute in attributes):
        return False
    own = {node.arg for node in ast.walk(definition.args) if isinstance(node, ast.arg)}
    own |= {name.id for name in names if isinstance(name.ctx, ast.Store)}
    known = {"abs": abs} | function.__globals__

    def of_module(attribute: ast.Attribute) -> Any:
        name = attribute.value.id if isinstance(attribute.value, ast.Name) else ""
        module = None if name in own else known.get(name)
        known_module = module is np or module is math
        return getattr(module, attribute.attr, None) if known_module else None

    modules = {id(attribute.value) for attribute in attributes}
    used = [known.get(n.id) for n in names if n.id not in own and id(n) not in modules]
    used += [of_module(attribute) for attribute in attributes]
    return all(isinstance(node, SYNTAX) for node in nodes) and all(
        _is_of_numbers(value) or is_arithmetic(value, (*callers, function)) for value in used
    )


def _is_of_numbers(value: Any) -> bool:
    """Return whether a global is a number or a pure function of numbers."""
    if isinstance(value, np.ufunc):
        return getattr(np, value.__name__, None) is value
    if isinstance(value, BuiltinFunctionType) and value.__module__ == "math":
        return True
    return type(value) in NUMBERS or any(value is function for function in OTHERS)


def _definition(function: FunctionType) -> ast.FunctionDef | None:
    """Return the definition of a function in the text of its file, None if it is not found."""
    code = function.__code__
    try:
        tree = ast.parse(read_regular(code.co_filename))
    except (OSError, ValueError, SyntaxError):
        return None
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.lineno == code.co_firstlineno:
            return node
    return None
