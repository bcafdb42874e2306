"""What hangs, put on what stands: a slab that rests on a roof raises it."""

import numpy as np

from jaxurban.kernels.compiled import compiled


@compiled(nogil=True)
def settle(roof_m, cell, floor_m, top_m, is_of_cell):
    """Raise roofs by the slabs that rest on them, in place, and return which hang freely, ``[H]`` bool.

    Args:
      roof_m: ``[Y * X]`` of the cells.
      cell: ``[H]`` int64 number of the cell that each slab hangs over, ascending; in one cell floors ascend.
      floor_m, top_m: ``[H]`` in the type of the roofs.
      is_of_cell: ``[H]`` bool: it counts for the whole cell; others raise no roof.
    """
    hangs = np.zeros(len(cell), np.bool_)
    for slab in range(len(cell)):
        if floor_m[slab] > roof_m[cell[slab]]:
            hangs[slab] = True
        elif is_of_cell[slab]:
            roof_m[cell[slab]] = max(roof_m[cell[slab]], top_m[slab])
    return hangs
