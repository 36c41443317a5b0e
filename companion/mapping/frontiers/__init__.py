"""What is known of the mine: frontiers and completeness, distances to obstacles, and what can be seen from where.

`state_grid` keeps the states of all voxels. `nearest` and `sight` ask it. So does a survey, on a plan at flight height
that is drawn through the map: `plan`. `surveyor` makes a survey in these steps:

1. `tiles`: over which cells of the plan the map has changed. Only what lies there and around it is found anew.
2. `flood`: the plan is drawn anew there, from where the vehicle was through all that is free; `flood_work` says what
   waits, and which of two nodes comes first.
3. `tiles`: what is free, and how much of floor and roof was seen there.
4. `walls`: what is too near to an obstacle, and what is unknown and may yet be only the surface of one.
5. `reachable`: what the vehicle can get to, and how far the way is. This alone goes through the whole plan, part by
   part.
6. `frontier_cells`: which unknown cells are frontiers, which of them belong together, and what is reported of each.
7. `frontier`: what a survey says. Whether the mission is done by that is said in `companion.control.completion`.
8. `left_out`: what was seen and cannot be looked into, and why; at the end of a flight only.
"""
