"""The flood fill that draws the plan, from where the vehicle was through all that is free, and keeps it right.

The plan is what a flood from all places flown at once would give: nodes nearer to them first; of the same number of
steps, in the order of their ranks (`flood_work`). So a node depends on those with fewer steps only, and when a part of
the map has changed what is on it is drawn anew, with all that was entered through it (`_remove`), and nothing else.
Whatever the order in which the map became known, the plan is the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.frontiers.flood_work import (
    RANK_OF_SIDES,
    Work,
    entered_from_mm,
    flown_around,
    flown_at,
    is_before,
    is_taken,
    touch,
    wait,
)
from companion.mapping.frontiers.plan import (
    CELLS,
    FLOWN,
    KEPT,
    NONE,
    SIDES,
    cell_of,
    first_sheet,
    is_node,
    kind_of,
    measure,
    on_tile,
    room_for,
)
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import FREE, UNKNOWN


@compiled
def follow_map(work: Work, cells: NDArray[np.int64]) -> None:
    """Bring the plan up to date on ``cells`` (n, 2), on which some voxel is different."""
    for n in range(cells.shape[0]):
        _measure_again(work, cells[n, 0], cells[n, 1])
    _settle(work)


@compiled
def add_flown(work: Work, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Have the flood begin too at ``places`` (n, 3) where the vehicle was: cells and heights in mm, in order of time.

    Returns:
        (n,) the new nodes; -1 where the vehicle was before on the same level, or there is no room.
    """
    nodes = np.empty(places.shape[0], np.int64)
    for n in range(places.shape[0]):
        nodes[n] = _fly(work, places[n, 0], places[n, 1], places[n, 2])
    _settle(work)
    return nodes


@compiled
def remove_flown(work: Work, node: Integer) -> None:
    """Have the flood begin no longer at a node that `add_flown` made."""
    _remove(work, node)
    _settle(work)


@inner
def _fly(work: Work, i: int, j: int, height_mm: int) -> int:
    plan, s, circle = work.plan, work.shape, work.circle
    if flown_at(plan, i, j, height_mm, s.level_mm) >= 0:
        return -1
    place = on_tile(i, j)
    sheet = first_sheet(plan, i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if is_node(plan, node) and not plan.flags[node] & FLOWN:
            _remove(work, node)
        sheet = int(plan.others[sheet])
    _enter(work, i, j, 1, 0, height_mm)
    made = flown_at(plan, i, j, height_mm, s.level_mm)
    if made >= 0:
        for n in range(circle.shape[0]):
            a, b = i + circle[n, 0], j + circle[n, 1]
            if not is_taken(plan, s, a, b, 2, n + 1, height_mm):
                wait(work.tasks, 2, a, b)
    return made


@inner
def _measure_again(work: Work, i: Integer, j: Integer) -> None:
    """Bring the nodes on cell (i, j) up to date with the map."""
    plan = work.plan
    place = on_tile(i, j)
    sheet = first_sheet(plan, i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        if is_node(plan, node):
            flown, kept = bool(plan.flags[node] & FLOWN), bool(plan.flags[node] & KEPT)
            height_mm, kind = measure(work.grid, work.shape, i, j, entered_from_mm(plan, node), flown)
            kind = _known(kind, flown, kept)
            was = np.int64(plan.kinds[node])
            if height_mm != plan.heights_mm[node] or (kind & 3 == FREE) != (was & 3 == FREE):
                _remove(work, node)
            elif kind != was:
                plan.kinds[node] = kind
                touch(work, i, j)
        sheet = int(plan.others[sheet])


@inner
def _settle(work: Work) -> None:
    """Do what waits, fewest steps first, until nothing does."""
    tasks = work.tasks
    steps = 0
    while steps <= tasks.state[2]:
        while tasks.heads[steps] >= 0:
            task = np.int64(tasks.heads[steps])
            tasks.heads[steps] = tasks.nexts[task]
            i, j = np.int64(tasks.cells[task, 0]), np.int64(tasks.cells[task, 1])
            tasks.nexts[task] = tasks.state[1]
            tasks.state[1] = task
            _look(work, i, j, steps)
        steps += 1
    tasks.state[2] = 0


@inner
def _look(work: Work, i: Integer, j: Integer, steps: Integer) -> None:
    """Let all enter cell (i, j) that do so with this number of steps, in the order of their ranks and heights."""
    plan = work.plan
    if steps == 2:
        near = work.near[: work.near.shape[0] - 10]
        for n in range(flown_around(plan, work.circle, i, j, near, near.shape[0] - 9)):
            _enter(work, i, j, steps, near[n, 1], np.int64(plan.heights_mm[near[n, 0]]))
    for side in range(4):
        a, b = i - SIDES[side, 0], j - SIDES[side, 1]
        place = on_tile(a, b)
        last_mm = np.int64(-(2**40))
        while True:
            # The lowest that was not yet.
            lowest_mm = np.int64(2**40)
            sheet = first_sheet(plan, a, b)
            while sheet >= 0:
                node = sheet * CELLS + place
                if plan.steps[node] == steps - 1 and is_node(plan, node) and kind_of(plan, node) == FREE:
                    height_mm = np.int64(plan.heights_mm[node])
                    if height_mm > last_mm:
                        lowest_mm = min(lowest_mm, height_mm)
                sheet = int(plan.others[sheet])
            if lowest_mm == 2**40:
                break
            _enter(work, i, j, steps, RANK_OF_SIDES + side, lowest_mm)
            last_mm = lowest_mm


@inner
def _enter(work: Work, i: Integer, j: Integer, steps: Integer, rank: Integer, from_mm: Integer) -> None:
    """Make a node on cell (i, j), unless one that comes before it is there; those that come after it go."""
    plan, s = work.plan, work.shape
    if is_taken(plan, s, i, j, steps, rank, from_mm):
        return
    place = on_tile(i, j)
    sheet = first_sheet(plan, i, j)
    while sheet >= 0:
        node = sheet * CELLS + place
        comes_after = is_node(plan, node) and not is_before(plan, node, steps, rank, from_mm)
        if comes_after and not plan.flags[node] & FLOWN:
            _remove(work, node)
        sheet = int(plan.others[sheet])
    node = room_for(plan, i, j)
    if node < 0:
        return
    flown, kept = bool(steps == 1), bool(rank < RANK_OF_SIDES)
    height_mm, kind = measure(work.grid, s, i, j, from_mm, flown)
    plan.heights_mm[node], plan.rises_mm[node] = height_mm, height_mm - from_mm
    plan.steps[node], plan.ranks[node] = steps, rank
    plan.flags[node] = FLOWN if flown else KEPT if kept else 0
    plan.kinds[node] = _known(kind, flown, kept)
    touch(work, i, j)
    if kind_of(plan, node) == FREE:
        _spread(work, node, i, j)


@inner
def _known(kind: Integer, flown: bool, kept: bool) -> int:
    """The same, where the vehicle was free: whoever has been there knows it."""
    return int(kind & ~3 | FREE) if flown or (kept and kind & 3 == UNKNOWN) else int(kind)


@inner
def _spread(work: Work, node: Integer, i: Integer, j: Integer) -> None:
    """Have the cells beside a free node looked at."""
    plan = work.plan
    steps = np.int64(plan.steps[node]) + 1
    height_mm = np.int64(plan.heights_mm[node])
    for side in range(4):
        a, b = i + SIDES[side, 0], j + SIDES[side, 1]
        if not is_taken(plan, work.shape, a, b, steps, RANK_OF_SIDES + side, height_mm):
            wait(work.tasks, steps, a, b)


@inner
def _remove(work: Work, node: Integer) -> None:
    """Take away a node, all on its cell that come after it, and all that was entered through them."""
    plan, circle = work.plan, work.circle
    waiting = np.empty(64, np.int64)
    removed = np.empty(64, np.int64)
    waiting[0] = node
    count, gone = 1, 0
    while count > 0:
        count -= 1
        at = waiting[count]
        if not is_node(plan, at):
            continue
        i, j = cell_of(plan, at)
        steps, rank, from_mm = np.int64(plan.steps[at]), np.int64(plan.ranks[at]), entered_from_mm(plan, at)
        height_mm = np.int64(plan.heights_mm[at])
        flown = bool(plan.flags[at] & FLOWN)
        plan.steps[at], plan.flags[at] = NONE, 0
        touch(work, i, j)
        if gone == removed.shape[0]:
            removed = np.concatenate((removed, np.empty_like(removed)))
        removed[gone] = at
        gone += 1
        around = 4 + (circle.shape[0] if flown else 0)
        for n in range(-1, around):
            if n < 0:
                a, b, its_rank = i, j, -1
            elif n < 4:
                a, b, its_rank = i + SIDES[n, 0], j + SIDES[n, 1], RANK_OF_SIDES + n
            else:
                a, b, its_rank = i + circle[n - 4, 0], j + circle[n - 4, 1], n - 3
            other = first_sheet(plan, a, b)
            its_place = on_tile(a, b)
            while other >= 0:
                its = other * CELLS + its_place
                if is_node(plan, its) and not plan.flags[its] & FLOWN:
                    if n < 0:
                        follows = not is_before(plan, its, steps, rank, from_mm)
                    else:
                        follows = (
                            plan.steps[its] == steps + 1
                            and plan.ranks[its] == its_rank
                            and entered_from_mm(plan, its) == height_mm
                        )
                    if follows:
                        if count == waiting.shape[0]:
                            waiting = np.concatenate((waiting, np.empty_like(waiting)))
                        waiting[count] = its
                        count += 1
                other = int(plan.others[other])
    for n in range(gone):
        _ask_again(work, *cell_of(plan, removed[n]))


@inner
def _ask_again(work: Work, i: Integer, j: Integer) -> None:
    """Have cell (i, j) looked at for all that may enter it."""
    plan = work.plan
    for side in range(4):
        a, b = i - SIDES[side, 0], j - SIDES[side, 1]
        sheet = first_sheet(plan, a, b)
        place = on_tile(a, b)
        while sheet >= 0:
            node = sheet * CELLS + place
            if is_node(plan, node) and kind_of(plan, node) == FREE:
                wait(work.tasks, np.int64(plan.steps[node]) + 1, i, j)
            sheet = int(plan.others[sheet])
    # The rest of the room may be in use: nodes are removed while others enter.
    if flown_around(plan, work.circle, i, j, work.near[work.near.shape[0] - 10 :], 1) > 0:
        wait(work.tasks, 2, i, j)
