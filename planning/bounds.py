"""Bounds of quantities: valid ranges for scenario files and for readers of plans.

Scenario sections, the planner and the readers of plans, logs and open plans share these values. The plan of a valid
scenario is therefore never rejected as damaged. Some quantities of a plan are computed from several values of the
scenario; their bounds are correspondingly larger.
"""

FARTHEST = 1e4
"""Greatest coordinate [m], and joint value [rad or m], of a scenario; larger values suggest a wrong unit."""

FARTHEST_COMPOSED = 100 * FARTHEST
"""Greatest coordinate, length and joint value of a plan, whose poses are composed of several scenario poses."""

THINNEST_M = 1e-4
"""Least edge length of a body [m]; collision libraries treat thinner bodies as flat."""

LARGEST_M = 1000
"""Greatest edge, radius and length of a body [m]."""

HEAVIEST_KG = 1e6
"""Greatest mass of a scenario [kg]."""

DENSEST_KG_M3 = 1e5
"""Greatest density [kg/m^3]."""

HEAVIEST_COMPOSED_KG = 1e15
"""Greatest mass of a plan [kg], above that of a box of LARGEST_M and DENSEST_KG_M3."""

LONGEST_S = 1e6
"""Longest duration that a scenario states [s]: eleven days."""

LATEST_S = 9e9
"""Latest time, and longest duration, of a plan and of an event log [s]: 64 bits of nanoseconds hold it."""

LONGEST_RUN_S = 2e9
"""Longest run [s]: 63 years, below the times that mean never."""

SLOWEST = 1e-3
"""Least limit of the speed, acceleration and jerk of a joint [rad or m, by s, s^2 and s^3]."""

FASTEST = 1e6
"""Greatest limit of the speed, acceleration and jerk of a joint in a scenario."""

FASTEST_DESCRIBED = 1e9
"""Greatest limit of a joint that a robot description may state."""

DEEPEST_M = 0.1
"""Greatest depth of an intended contact [m]."""

LARGEST_ERROR = 0.1
"""Greatest standard deviation of a pose [m or rad]."""

LIMIT_SLACK = 1e-6
"""How far joint values of a plan may be beyond the limits, for values that were rounded [rad or m]."""

HOME_SLACK = 1e-4
"""How far HOME may be beyond the limits in a scenario; it is moved onto them [rad or m]. Descriptions
round half a turn to four decimals."""

MOST_ROBOTS = 1000
"""Most robots of a cell."""

MOST_OF_TEAM = 100
"""Most robots of the team of a cell."""

MOST_JOINTS = 100
"""Most joints of a robot."""

MOST_ELEMENTS = 10_000
"""Most elements of a compound shape, and most convex pieces of a mesh."""

LONGEST_NAME = 64
"""Most letters of a name in a scenario."""

LONGEST_COPY_NAME = 2 * LONGEST_NAME
"""Most letters of a name in a plan, which has the number of a copy."""
