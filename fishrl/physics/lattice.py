"""The D2Q9 lattice as Python tuples, so that every operator unrolls at trace time.

Order: rest, east, north, west, south, north-east, north-west, south-west, south-east; y grows
upward. Source: Qian, d'Humieres & Lallemand 1992 (weights and speed of sound).
"""

CX = (0, 1, 0, -1, 0, 1, -1, -1, 1)
CY = (0, 0, 1, 0, -1, 1, 1, -1, -1)
W = (4 / 9, *(4 * [1 / 9]), *(4 * [1 / 36]))
OPPOSITE = (0, 3, 4, 1, 2, 7, 8, 5, 6)
Q = 9

#: Largest speed that an edge or a prescribed motion may impose, nodes per step: Mach 0.52.
MAX_IMPOSED_SPEED = 0.3
