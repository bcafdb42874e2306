"""A stranger's script: it passes ``mypy --strict`` and runs against the wheel alone (tests/try_wheel.sh)."""

from pathlib import Path

import jaxurban as ju
from jaxurban.plot import plot_paths


def main(folder: Path) -> None:
    """Plan over a real city, with two weights of GPS, and write what is found."""
    folder.mkdir(exist_ok=True)
    maps = ju.build_maps(
        ju.sample_city("lower-manhattan"), resolution_m=10.0, altitudes_m=(20.0, 60.0)
    )
    start, goal = (-74.0165, 40.7035), (-73.9900, 40.7290)
    names = ["default weights", "GPS counts five times"]
    routes = [
        ju.plan(maps, start, goal, altitude_m=20.0, weights=weights, snap=True)
        for weights in ({}, {"gps": 5.0})
    ]
    for name, route in zip(names, routes, strict=True):
        print(
            f"{name}: {route.status.value}, {route.length_m:.0f} m, GPS {route.metrics['gps']:.2f}"
        )
    print(ju.__version__, ju.explain(routes[0], maps).table())
    routes[1].save(folder / "route.geojson")
    plot_paths(maps, routes, names=names).savefig(folder / "routes.png")
    maps.save(folder / "maps")
    print(
        sorted(ju.open_maps(folder / "maps").metrics),
        sorted(path.name for path in folder.iterdir()),
    )


if __name__ == "__main__":
    main(Path("out"))
