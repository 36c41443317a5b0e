"""Taking back what the flood drew: a node goes, and with it all that was entered through it.

Nothing is drawn here. The cells that lost a node wait for what may enter them now, and `flood` goes on from there.
"""

from __future__ import annotations

import numpy as np

from companion.compiled import inner
from companion.mapping.frontiers.flood_order import RANK_OF_SIDES, entered_from_mm, is_before
from companion.mapping.frontiers.flood_work import Work, touch, wait
from companion.mapping.frontiers.flown import flown_around
from companion.mapping.frontiers.plan import CELLS, FLOWN, NONE, SIDES, first_sheet, is_node, kind_of, on_tile
from companion.mapping.voxels.chunks import Integer
from companion.mapping.voxels.lookup import FREE


@inner
def remove(work: Work, node: Integer) -> None:
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
        sheet, place = at // CELLS, at % CELLS
        i, j = plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15)
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
        sheet, place = removed[n] // CELLS, removed[n] % CELLS
        _ask_again(work, plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15))


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
