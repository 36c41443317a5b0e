"""From faults to the stage of the answer: brake, then hold, then land, each with its own delay. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from companion.gate.faults import CLEARS, Clear, Fault, Stage
from companion.gate.plan import Reaction


class Escalation:
    """Which stage all faults together ask for.

    A fault counts from its first appearance until it has been gone for ``recover_s``, so that one which comes and goes
    climbs as one that stays. `Stage.HOLD` and `Stage.LAND` are left by `reset` only: by a person.

    Args:
        reactions: of every fault.
        recover_s: a fault must be gone for this long.

    Attributes:
        stage: what is to be done now.
        because: the fault that asked for it first; None while the application's setpoints pass.
    """

    def __init__(self, reactions: Mapping[Fault, Reaction], recover_s: float) -> None:
        self.stage = Stage.PASS
        self.because: Fault | None = None
        self._reactions = reactions
        self._recover_s = recover_s
        self._since_s: dict[Fault, float] = {}
        self._seen_s: dict[Fault, float] = {}

    @property
    def counting(self) -> frozenset[Fault]:
        """The faults that count now."""
        return frozenset(self._since_s)

    def update(self, found: frozenset[Fault], now_s: float) -> frozenset[Fault]:
        """Take note of the faults there are at ``now_s``; gives those that are new."""
        new = found - self.counting
        for fault in found:
            self._since_s.setdefault(fault, now_s)
            self._seen_s[fault] = now_s
        for fault, seen_s in tuple(self._seen_s.items()):
            if CLEARS[fault] is Clear.BY_ITSELF and fault not in found and now_s - seen_s >= self._recover_s:
                del self._since_s[fault], self._seen_s[fault]
        self._climb(now_s)
        return new

    def force(self, stage: Stage) -> None:
        """The present stage cannot be had: go on to a later one."""
        self.stage = max(self.stage, stage)

    def reset(self) -> None:
        """A new flight, which a person has begun."""
        self.stage, self.because = Stage.PASS, None
        self._since_s.clear()
        self._seen_s.clear()

    def _climb(self, now_s: float) -> None:
        stage, because = Stage.PASS, None
        # Of those that began together the first by name: a set has no order of its own.
        for fault, since_s in sorted(self._since_s.items(), key=lambda item: (item[1], item[0])):
            wanted = self._wanted(self._reactions[fault], now_s - since_s)
            if wanted > stage:
                stage, because = wanted, fault
        if self.stage >= Stage.HOLD and stage <= self.stage:
            return
        self.stage, self.because = stage, because

    @staticmethod
    def _wanted(reaction: Reaction, for_s: float) -> Stage:
        wanted = reaction.first
        for stage, after_s in ((Stage.HOLD, reaction.hold_after_s), (Stage.LAND, reaction.land_after_s)):
            if after_s is not None and for_s >= after_s:
                wanted = max(wanted, stage)
        return wanted
