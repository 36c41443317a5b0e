"""What waits to be put into the map: the newest of each sensor first, and the sensors in turn."""

from __future__ import annotations

from collections import deque

from companion.mapping.process.messages import Offered


class Waiting:
    """Offers that have not been put into the map. Each sensor has few slots, so there are never many.

    When there is not time for all, the map still follows the vehicle, and with all its eyes: a sensor that was just
    served comes last, however fast it is.

    Args:
        sources: how many sensors there are.
    """

    def __init__(self, sources: int) -> None:
        self._stacks: list[list[Offered]] = [[] for _ in range(sources)]
        self._turns = deque(range(sources))

    def __len__(self) -> int:
        return sum(map(len, self._stacks))

    def add(self, offered: Offered) -> None:
        """A new one."""
        self._stacks[offered.source].append(offered)

    def pop(self) -> Offered:
        """The next one to be put into the map.

        Raises:
            IndexError: nothing waits.
        """
        for source in self._turns:
            if self._stacks[source]:
                self._turns.remove(source)
                self._turns.append(source)
                return self._stacks[source].pop()
        raise IndexError("nothing waits")
