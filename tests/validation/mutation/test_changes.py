"""The mutation tool itself: whatever it fails to change, it would report as tested."""

from __future__ import annotations

import ast
from types import CodeType

from validation.mutation.changes import mutants
from validation.mutation.running import codes

SOURCE = '''
"""Text."""
MOST = 3
NAMED = "not a number"

def outer(a: int, b: int = 1) -> int:
    """Text."""
    def inner() -> bool:
        return a < b
    return a + 2 if inner() else max(a, b)

class Thing:
    @property
    def half(self) -> float:
        total = 0.0
        total += abs(self.x)
        return total
'''


def found() -> set[tuple[str, str, str]]:
    return {(one.function or one.constant, one.before, one.after) for one in mutants(SOURCE)}


def test_each_kind_of_change_is_made_in_its_place() -> None:
    """Protects the count: functions within functions, properties and constants are code like any other."""
    assert found() == {
        ("MOST", "3", "4"),
        ("outer.<locals>.inner", "return a < b", "return None"),
        ("outer.<locals>.inner", "a < b", "a <= b"),
        ("outer.<locals>.inner", "a < b", "a >= b"),
        ("outer", "return a + 2 if inner() else max(a, b)", "return None"),
        ("outer", "a + 2 if inner() else max(a, b)", "a + 2 if True else max(a, b)"),
        ("outer", "a + 2 if inner() else max(a, b)", "a + 2 if False else max(a, b)"),
        ("outer", "a + 2", "a - 2"),
        ("outer", "2", "3"),
        ("outer", "max", "min"),
        ("Thing.half", "total = 0.0", "pass"),
        ("Thing.half", "0.0", "0.5"),
        ("Thing.half", "total += abs(self.x)", "pass"),
        ("Thing.half", "total += abs(self.x)", "total -= abs(self.x)"),
        ("Thing.half", "abs(self.x)", "self.x"),
        ("Thing.half", "return total", "return None"),
    }


def test_every_change_compiles_and_is_one() -> None:
    """Protects against changes that are none: they would survive, or be killed for the wrong reason."""
    original = ast.unparse(ast.parse(SOURCE))
    texts = [ast.unparse(one.tree) for one in mutants(SOURCE)]
    assert original not in texts
    assert len(set(texts)) == len(texts)
    for one in mutants(SOURCE):
        names = {code.co_qualname for code in codes(compile(one.tree, "text", "exec")) if isinstance(code, CodeType)}
        assert {"outer", "outer.<locals>.inner", "Thing.half"} <= names
