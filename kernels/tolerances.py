"""Tolerances: by how much values in float64 may differ that are equal in exact numbers; then those of paths' files."""

SAME_COST = 1 + 1e-12  # a cost at most this many times another, or a bound, is no larger
CHEAPER = 1 - 1e-12  # a cost below this many times another is lower by more than rounding
INSIDE = 1 - 1e-12  # of a map's sides: points on its outer border belong to no cell
SAME_LENGTH = 1e-9  # relative, and of a cell's side: lengths that differ by less are equal
AT_LIMIT = 1e-9  # relative, and in metres: what exceeds a limit by less keeps it
SAME_COUNT = 1e-9  # relative: weighted counts that differ by less are equal
SAME_ROUTE_COST = 1e-9  # relative: routes whose summed costs differ by less are as cheap
SAME_RECORDED_COST = 1e-6  # relative: a cost in a file, and that of the same route computed again
SAME_HEIGHT_M = 1e-6  # heights along a step that differ by less are equal
SAME_PLACE_M = 1e-6  # from a map's corner and in its CRS: points nearer than this are one
SAME_EXPOSURE = 1e-9  # relative: an exposure so little above its budget keeps it, a cost so near a bound meets it

# What a file may take from a clearance: 8 mm by the seventh decimal of a degree, and up to 35 mm where a program draws
# a leg of 1 km straight in degrees instead of in the maps' CRS (length^2 / 8 R x tan of a latitude up to 60 degrees).
FILE_MARGIN_M = 0.05
BESIDE_M = 3.0  # nearer to a wall a route says so first, and legs of its mission that leave it come no nearer
MOST_BULGE_M = 0.05  # between two places below a path, by which the ground leaves the straight line
GROUND_TOLERANCE_M = (
    1.0  # by which a file's straight lines may exceed the planned height above ground
)
