"""Small changes of a source text, each of which should break a test."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_SCOPES = (*_FUNCTIONS, ast.ClassDef)
_SIMPLE = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.Expr, ast.Raise, ast.Delete)
_OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.Pow: (ast.Mult,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitOr,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Break: (ast.Continue,),
    ast.Continue: (ast.Break,),
}
_NAMES = {"max": "min", "min": "max", "any": "all", "all": "any", "cos": "sin", "sin": "cos", "popleft": "pop"}
_HOLDERS = (ast.Compare, ast.BinOp, ast.BoolOp, ast.AugAssign)


@dataclass(frozen=True)
class Mutant:
    """One changed text.

    Attributes:
        function: qualified name of the function in which the change is; empty: a constant of the module.
        constant: name of the constant; empty: in a function.
        line: number of the changed line.
        before: the changed expression or statement.
        after: what stands in its place.
        tree: the whole changed module.
    """

    function: str
    constant: str
    line: int
    before: str
    after: str
    tree: ast.Module


def mutants(source: str) -> Iterator[Mutant]:
    """Every change of a module: within its functions, and of the numbers that it gives names to."""
    tree = ast.parse(source)
    for node, function in tuple(_within_functions(tree)):
        for changed in _changed(node):
            yield _mutant(tree, node, changed, function, "")
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            number = statement.value
            if isinstance(number, ast.Constant) and isinstance(number.value, int | float):
                for changed in _constants(number):
                    yield _mutant(tree, number, changed, "", statement.targets[0].id)


def _within_functions(node: ast.AST, name: str = "", *, within: bool = False) -> Iterator[tuple[ast.AST, str]]:
    """All that runs when a function is called, with the function's name; no docstrings, annotations or defaults."""
    if isinstance(node, _SCOPES):
        inner = f"{name}.<locals>.{node.name}" if within else f"{name}.{node.name}".lstrip(".")
        for statement in node.body:
            if not _is_text(statement):
                yield from _within_functions(statement, inner, within=isinstance(node, _FUNCTIONS))
        return
    if within:
        yield node, name
    for child in ast.iter_child_nodes(node):
        if not _is_annotation(node, child):
            yield from _within_functions(child, name, within=within)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _is_annotation(parent: ast.AST, child: ast.AST) -> bool:
    return isinstance(parent, ast.AnnAssign) and child is parent.annotation


def _changed(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of a node."""
    if isinstance(node, _SIMPLE) and not (isinstance(node, ast.AnnAssign) and node.value is None):
        yield ast.Pass()
    if isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield ast.Return(ast.Constant(None))
    if isinstance(node, ast.Break | ast.Continue):
        yield from (operator() for operator in _OPERATORS[type(node)])
    if isinstance(node, _HOLDERS):
        yield from _operators(node)
    if isinstance(node, ast.BoolOp):
        for i in range(len(node.values)):
            kept = [value for j, value in enumerate(node.values) if j != i]
            yield kept[0] if len(kept) == 1 else ast.BoolOp(node.op, kept)
    if isinstance(node, ast.UnaryOp):
        yield node.operand
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        # A loop that never ends is no change of interest.
        for answer in (False,) if isinstance(node, ast.While) else (True, False):
            forced = copy.copy(node)
            forced.test = ast.Constant(answer)
            yield forced
    if isinstance(node, ast.comprehension):
        for i in range(len(node.ifs)):
            yield ast.comprehension(node.target, node.iter, node.ifs[:i] + node.ifs[i + 1 :], node.is_async)
    if isinstance(node, ast.Constant):
        yield from _constants(node)
    if isinstance(node, ast.Name) and node.id in _NAMES:
        yield ast.Name(_NAMES[node.id], node.ctx)
    if isinstance(node, ast.Attribute):
        if node.attr in _NAMES:
            yield ast.Attribute(node.value, _NAMES[node.attr], node.ctx)
        if node.attr == "inf":
            yield ast.Constant(0.0)
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("abs", "int", "float", "sorted")
    ):
        yield node.args[0]


def _operators(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            for other in _OPERATORS[type(operator)]:
                ops: list[ast.AST] = [*node.ops[:i], other(), *node.ops[i + 1 :]]
                yield ast.Compare(node.left, ops, node.comparators)  # type: ignore[arg-type]
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign):
        for other in _OPERATORS.get(type(node.op), ()):
            changed = copy.copy(node)
            changed.op = other()  # type: ignore[assignment]
            yield changed


def _constants(node: ast.Constant) -> Iterator[ast.AST]:
    value = node.value
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        yield ast.Constant(value + 1)
    elif isinstance(value, float):
        yield ast.Constant(1.25 * value if value else 0.5)
        if value:
            yield ast.Constant(0.8 * value)
    elif isinstance(value, str | bytes) and value:
        yield ast.Constant("XX" + value if isinstance(value, str) else b"XX" + value)


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _mutant(tree: ast.Module, node: ast.AST, changed: ast.AST, function: str, constant: str) -> Mutant:
    """The module with one node in the place of another."""
    line = node.target.lineno if isinstance(node, ast.comprehension) else getattr(node, "lineno", 0)
    # All is copied but the node itself, by which it is found again.
    whole = copy.deepcopy(tree, {id(node): node})
    _Replace(node, changed).visit(whole)
    return Mutant(function, constant, line, _text(node), _text(changed), ast.fix_missing_locations(whole))


class _Replace(ast.NodeTransformer):
    def __init__(self, node: ast.AST, changed: ast.AST) -> None:
        self._node = node
        self._changed = changed

    def visit(self, node: ast.AST) -> ast.AST:
        found: ast.AST = self._changed if node is self._node else self.generic_visit(node)
        return found


def _text(node: ast.AST) -> str:
    text = "if " + ast.unparse(node.test) if isinstance(node, ast.If | ast.While) else ast.unparse(node)
    return " ".join(text.split())
