"""Small changes of a program's text, in the manner of cosmic-ray's and mutmut's operators."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("service", "bus", "engine", "network")
_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}  # fmt: skip
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv,
}  # fmt: skip
#: What it does, the change, and the node it is at.
_Change = tuple[str, Callable[[], None], ast.expr | ast.stmt]
#: Calls whose absence no test can be asked to see.
_SILENT = ("_log", "logging")


@dataclass(frozen=True)
class Mutant:
    """One change. place: the number of the node in a walk of the module, and of the change at it; at: first and last line of
    what is changed."""

    path: str
    line: int
    place: tuple[int, int]
    what: str
    at: tuple[int, int]


def mutants(path: Path, root: Path) -> list[Mutant]:
    """All changes of a module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    decorations = _in_decorators(tree)
    for number, node in enumerate(ast.walk(tree)):
        if node in decorations:
            continue
        for kind, (what, _, at) in enumerate(_changes(node)):
            lines = (at.lineno, at.end_lineno or at.lineno)
            found.append(Mutant(str(path.relative_to(root)), getattr(node, "lineno", at.lineno), (number, kind), what, lines))
    return found


def _in_decorators(tree: ast.AST) -> set[ast.AST]:
    """What `frozen` and `slots` say is a guard for programmers; without it a program does the same."""
    decorators = (d for node in ast.walk(tree) for d in getattr(node, "decorator_list", ()))
    return {node for decorator in decorators for node in ast.walk(decorator)}


def mutated(mutant: Mutant, root: Path) -> str:
    """The module's text with the change."""
    tree = ast.parse((root / mutant.path).read_text(encoding="utf-8"))
    number, kind = mutant.place
    node = next(node for place, node in enumerate(ast.walk(tree)) if place == number)
    change = next(change for place, (_, change, _) in enumerate(_changes(node)) if place == kind)
    change()
    return ast.unparse(ast.fix_missing_locations(tree))


def _changes(node: ast.AST) -> Iterator[_Change]:  # noqa: C901, PLR0912 - a branch an operator
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for other in _COMPARISONS.get(type(node.ops[0]), ()):
            yield f"{type(node.ops[0]).__name__} to {other.__name__}", _setter(node, "ops", [other()]), node
    elif isinstance(node, ast.BoolOp):
        other_op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield f"{type(node.op).__name__} to {type(other_op).__name__}", _setter(node, "op", other_op), node
    elif isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC and not _is_text(node) and not _is_type(node):
        swapped = _ARITHMETIC[type(node.op)]()
        yield f"{type(node.op).__name__} to {type(swapped).__name__}", _setter(node, "op", swapped), node
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "not left out", _becomes_operand(node), node
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} to {not node.value}", _setter(node, "value", not node.value), node
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield f"{node.value} to {_other(node.value)}", _setter(node, "value", _other(node.value)), node
    elif isinstance(node, ast.If | ast.While) and not _is_typing(node.test):
        yield "condition never holds", _setter(node, "test", ast.Constant(False)), node.test
        if isinstance(node, ast.If):
            yield "condition always holds", _setter(node, "test", ast.Constant(True)), node.test
    for field in ("body", "orelse", "finalbody"):
        statements = getattr(node, field, None)
        if isinstance(statements, list):
            for place, statement in enumerate(statements):
                if _may_go(statement):
                    yield f"line {statement.lineno} left out", _remover(statements, place), statement


def _other(value: float) -> float:
    return value + 1 if isinstance(value, int) else value * 2.0 + 1.0


def _setter(node: ast.AST, name: str, value: object) -> Callable[[], None]:
    return lambda: setattr(node, name, value)


def _becomes_operand(node: ast.UnaryOp) -> Callable[[], None]:
    def change() -> None:
        node.op, node.operand = ast.Not(), ast.UnaryOp(ast.Not(), node.operand)

    return change


def _remover(statements: list[ast.stmt], place: int) -> Callable[[], None]:
    def change() -> None:
        statements[place] = ast.Pass()

    return change


def _may_go(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Raise | ast.AugAssign):
        return True
    if isinstance(statement, ast.Assign):
        # An attribute; a name that is missing would be found by anything.
        return isinstance(statement.targets[0], ast.Attribute | ast.Subscript)
    if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call)):
        return False
    return not ast.unparse(statement.value.func).startswith(_SILENT)


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    texts = (side.value for side in sides if isinstance(side, ast.Constant))
    return any(isinstance(side, ast.JoinedStr) for side in sides) or any(isinstance(text, str) for text in texts)


def _is_type(node: ast.BinOp) -> bool:
    """Whether it looks like a union of types, which only a type checker sees."""
    sides = (node.left, node.right)
    plain = (isinstance(side, ast.Name | ast.Attribute | ast.Subscript | ast.Constant) for side in sides)
    numbers = (isinstance(side, ast.Constant) and side.value is not None for side in sides)
    return isinstance(node.op, ast.BitOr) and all(plain) and not any(numbers)


def _is_typing(test: ast.expr) -> bool:
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"
