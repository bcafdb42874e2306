"""How many pairs of places each rule about obstacles leaves joined: the table of docs/evidence/routes.md.

Run as ``python -m benchmarks.joined 5 2``, with the sides of cells in metres. Pairs are of all cells that are free both
by centres and where no outline touches, 20 m up.
"""

import argparse
import warnings

import numpy as np
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.errors import GuessWarning

ALTITUDE_M = 20.0
RULES = {
    "centre": {"preset": "paper"},
    "touched": {"constraints": ju.Constraints(vertical_clearance_m=0.0)},
    "touched, 3 m over roofs (default)": {},
}


def joined_percent(is_free: np.ndarray, is_place: np.ndarray) -> float:
    """Return the percentage of pairs of places that free cells join; a place that is closed is joined to none.

    Steps go over sides: diagonal ones need both cells beside them free.
    """
    islands, _ = label(is_free)
    sizes = np.bincount(islands[is_place & is_free]).astype(float)
    return 100 * float((sizes**2).sum()) / float(is_place.sum()) ** 2


def main() -> None:
    """Print a row for each sample city and side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sides_m", nargs="+", type=float)
    warnings.simplefilter("ignore", GuessWarning)
    print(f"| city | cells | {' | '.join(RULES)} |")
    for side_m in parser.parse_args().sides_m:
        for city in ("lower-manhattan", "shinjuku"):
            maps = ju.build_maps(
                ju.sample_city(city, kinds=["building"]),
                resolution_m=side_m,
                altitudes_m=(ALTITUDE_M,),
                progress=False,
            )
            is_free = [ju.cost_map(maps, ALTITUDE_M, **rule).is_free for rule in RULES.values()]
            shares = [f"{joined_percent(free, is_free[0] & is_free[1]):.1f} %" for free in is_free]
            print(f"| {city} | {side_m:g} m | {' | '.join(shares)} |", flush=True)


if __name__ == "__main__":
    main()
