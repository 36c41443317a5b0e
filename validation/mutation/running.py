"""Runs the tests against every change, each in a process of its own that is forked from one in which all is loaded."""

from __future__ import annotations

import gc
import inspect
import os
import signal
import sys
import time
from collections import Counter, defaultdict
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import coverage
import pytest

from validation.mutation.changes import Mutant, mutants
from validation.mutation.report import Found, report

PACKAGE = "companion"
ROOMS = ("gate", "mavlink", "safety_case")
KILLED, SURVIVED = 1, 0
LONGEST_S = 60.0
"""Of the processor, for one change; what takes longer runs in circles."""
QUICK_S = 0.1
"""Of the processor, for one test."""


class Mutation:
    """A plugin of pytest that runs each test once to see which lines it needs, and then the changes.

    A change is put into the running program by giving the function another code object: nothing is imported again, and
    nothing on the disk is touched. A constant is changed in every module that has it under its name.

    Args:
        folder: of the repository.
        names: modules of the package to change, such as ``gate.motion``.
        quick: leave out tests that take longer than `QUICK_S`: what survives then may still be found by those.

    Attributes:
        exit_code: 1 when a test failed without any change, or when changes survived that nobody argued for.
    """

    def __init__(self, folder: Path, names: list[str], *, quick: bool) -> None:
        self.exit_code = 1
        self._quick = quick
        self._folder = folder
        self._names = names
        self._failed: list[str] = []
        self._duration_s: dict[str, float] = {}
        self._items: dict[str, pytest.Item] = {}
        self._tests_of_line: dict[tuple[str, int], list[str]] = {}
        self._killers: dict[tuple[str, str], list[str]] = defaultdict(list)

    def pytest_configure(self) -> None:
        """The same examples each time, and none of them made smaller: a failure is a failure."""
        # Not before: pytest wants to be the first to import it.
        from hypothesis import HealthCheck, Phase, settings

        phases = (Phase.explicit, Phase.generate)
        quick = settings(
            deadline=None,
            database=None,
            derandomize=True,
            max_examples=30,
            phases=phases,
            suppress_health_check=list(HealthCheck),
        )
        settings.register_profile("mutants", quick)
        settings.load_profile("mutants")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note which tests fail."""
        if report.failed:
            self._failed.append(report.nodeid)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """In place of pytest's own."""
        session.config.pluginmanager.unregister(name="terminalreporter")
        self._items = {item.nodeid: item for item in session.items}
        if not self._run_unchanged():
            return True
        gc.freeze()
        found = [one for name in self._names for one in self._of_module(name)]
        self.exit_code = report(found, self._folder)
        return True

    def _run_unchanged(self) -> bool:
        files = [str(self._folder / PACKAGE / room / "*") for room in ROOMS]
        traced = coverage.Coverage(data_file=None, include=files, config_file=False)
        traced.start()
        for nodeid, item in self._items.items():
            traced.switch_context(nodeid)
            begun_s = time.process_time()
            self._run(item)
            self._duration_s[nodeid] = time.process_time() - begun_s
        traced.stop()
        _say(f"{len(self._items)} tests, {sum(self._duration_s.values()):.1f} s of the processor")
        for nodeid in self._failed:
            _say(f"fails without any change: {nodeid}")
        data = traced.get_data()
        for file in data.measured_files():
            for line, contexts in data.contexts_by_lineno(file).items():
                self._tests_of_line[file, line] = [name for name in contexts if name]
        return not self._failed

    def _run(self, item: pytest.Item) -> bool:
        """Whether a test passes."""
        before = len(self._failed)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
        return len(self._failed) == before

    def _of_module(self, name: str) -> list[Found]:
        module = import_module(f"{PACKAGE}.{name}")
        source = inspect.getsource(module)
        found = [Found.of(name, mutant, self._verdict(module, mutant)) for mutant in mutants(source)]
        words = ", ".join(f"{count} {verdict}" for verdict, count in Counter(one.verdict for one in found).items())
        _say(f"{name}: {len(found)} changes, {words or 'none possible'}")
        for one in found:
            if one.verdict == "survived":
                _say(f"  {one.name}  (line {one.line})")
        return found

    def _verdict(self, module: ModuleType, mutant: Mutant) -> str:
        tests = self._tests_for(module, mutant)
        if not tests:
            return "survived"
        pipe_read, pipe_write = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(pipe_read)
            self._in_child(module, mutant, tests, pipe_write)
        os.close(pipe_write)
        with open(pipe_read, encoding="utf-8") as pipe:  # noqa: PTH123 - a descriptor
            killer = pipe.read()
        _, status = os.waitpid(pid, 0)
        if os.WIFSIGNALED(status):
            return "timed out" if os.WTERMSIG(status) == signal.SIGPROF else "killed"
        if os.WEXITSTATUS(status) == SURVIVED:
            return "survived"
        killers = self._killers[module.__name__, mutant.function]
        if killer and killer not in killers:
            killers.insert(0, killer)
        return "killed"

    def _in_child(self, module: ModuleType, mutant: Mutant, tests: list[str], pipe: int) -> None:
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        code = KILLED
        try:
            _apply(module, mutant)
            for nodeid in tests:
                if not self._run(self._items[nodeid]):
                    os.write(pipe, nodeid.encode())
                    break
            else:
                code = SURVIVED
        finally:
            os._exit(code)

    def _tests_for(self, module: ModuleType, mutant: Mutant) -> list[str]:
        """Those that run the line; those that found other changes of the function first, then the quick ones."""
        file = str(module.__file__)
        if mutant.function:
            names = set(self._tests_of_line.get((file, mutant.line), ()))
        else:
            names = self._users_of(mutant.constant)
        if self._quick:
            names = {name for name in names if self._duration_s[name] < QUICK_S}
        killers = self._killers[module.__name__, mutant.function]
        order = {name: place for place, name in enumerate(killers)}
        return sorted(names, key=lambda name: (order.get(name, len(order)), self._duration_s[name]))

    def _users_of(self, constant: str) -> set[str]:
        """The tests that run a function in which the constant is named; all when there is none."""
        names: set[str] = set()
        for name, module in tuple(sys.modules.items()):
            if name.startswith(f"{PACKAGE}."):
                for code in codes(compile(inspect.getsource(module), str(module.__file__), "exec")):
                    if code.co_name != "<module>" and constant in code.co_names:
                        lines = {line for _, _, line in code.co_lines() if line is not None}
                        for line in lines - {code.co_firstlineno}:
                            names.update(self._tests_of_line.get((str(module.__file__), line), ()))
        return names or set(self._items)


def codes(code: CodeType) -> list[CodeType]:
    """A code object and all within."""
    inner = [found for one in code.co_consts if isinstance(one, CodeType) for found in codes(one)]
    return [code, *inner]


def _apply(module: ModuleType, mutant: Mutant) -> None:
    compiled = compile(mutant.tree, str(module.__file__), "exec")
    if mutant.constant:
        before = getattr(module, mutant.constant)
        after = eval(mutant.after, {})  # noqa: S307 - a number
        for name, other in tuple(sys.modules.items()):
            if name.startswith((f"{PACKAGE}.", "tests.")):
                held: dict[str, Any] = vars(other)
                if held.get(mutant.constant) is before:
                    held[mutant.constant] = after
        return
    outermost = mutant.function.split(".<locals>")[0]
    (changed,) = (code for code in codes(compiled) if code.co_qualname == outermost)
    _function(module, outermost).__code__ = changed


def _function(module: ModuleType, name: str) -> FunctionType:
    found: Any = module
    for part in name.split("."):
        found = inspect.getattr_static(found, part)
    if isinstance(found, property):
        found = found.fget
    found = getattr(found, "__func__", found)
    assert isinstance(found, FunctionType), name
    return found


def _say(words: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {words}\n")
    sys.stdout.flush()
