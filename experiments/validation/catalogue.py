"""All cases, in the order of the report. A new case is a file and its name here, twice."""

from experiments.validation import (
    cavity, channel_cylinder, compressibility, d_cylinder, free_cylinder, gaits, invariance,
    oscillating_cylinder, outflow, poiseuille, settling_disc, sheared_ellipse, slip, stability,
    swimmer, taylor_green, turning,
)  # fmt: skip

CASES = (
    taylor_green.CASE,
    poiseuille.CASE,
    cavity.CASE,
    invariance.CASE,
    slip.CASE,
    channel_cylinder.CASE,
    free_cylinder.CASE,
    d_cylinder.CASE,
    outflow.CASE,
    oscillating_cylinder.CASE,
    settling_disc.CASE,
    sheared_ellipse.CASE,
    swimmer.CASE,
    gaits.CASE,
    turning.CASE,
    compressibility.CASE,
    stability.CASE,
)
