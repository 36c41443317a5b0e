"""Who may command from a page that the whole network can open."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from companion.ground.access import Access, new_code

CODE = "123456"


def client(number: int) -> Any:
    return SimpleNamespace(client_id=number)


def test_without_a_code_everybody_may() -> None:
    """Protects the operator alone at a computer from a question that protects nobody."""
    assert Access(None).has(client(1))


def test_with_a_code_only_who_has_typed_it_may() -> None:
    """Protects the vehicle: a visitor of the page watches; and who comes back is asked again."""
    access = Access(CODE)
    assert not access.has(client(1))
    assert access.admit(1, f" {CODE} ") == ""
    assert access.has(client(1))
    assert not access.has(client(2))
    access.forget(client(1))
    assert not access.has(client(1))


def test_codes_cannot_be_tried_out() -> None:
    """Protects from guessing: after a wrong code the right one is not looked at for some seconds, whoever types it."""
    now = [0.0]
    access = Access(CODE, now_s=lambda: now[0])
    assert "not the code" in access.admit(1, "000000")
    now[0] = 2.9
    assert "wait" in access.admit(2, CODE)
    assert not access.has(client(2))
    now[0] = 3.0
    assert access.admit(2, CODE) == ""


@pytest.mark.parametrize("typed", ["", "12345", "1234567", "١٢٣٤٥٦", "123456\x00"])
def test_what_is_no_code_is_refused(typed: str) -> None:
    """Protects from comparisons that fail on odd text."""
    assert Access(CODE).admit(1, typed) != ""


def test_codes_are_six_digits_and_not_always_the_same() -> None:
    """Protects from a code that everybody knows."""
    codes = {new_code() for _ in range(20)}
    assert len(codes) > 1
    assert all(len(code) == 6 and code.isdigit() for code in codes)
