#!/bin/sh
# Installs the wheel beside the pinned packages of the environment and uses it from an empty folder.
# usage: try_wheel.sh PYTHON DIST_FOLDER
set -eu
python=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")  # not realpath: a venv is known by its link
wheel=$(realpath "$2"/jaxurban-*.whl)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"$python" -m pip -q --disable-pip-version-check install --no-deps --target "$place/site" "$wheel"
cd "$place"
PYTHONPATH="$place/site" "$python" - "$place/site" <<'PY'
import sys
from pathlib import Path

import jaxurban
import jaxurban.kernels.distance
import jaxurban.planners.registry

for module in (jaxurban, jaxurban.kernels.distance, jaxurban.planners.registry):
    assert Path(module.__file__).is_relative_to(sys.argv[1]), f"{module.__name__} is not the wheel's: {module.__file__}"
city = jaxurban.demo_city(1_000, 1_000)
maps = jaxurban.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,))
x_m, y_m = maps.grid.x_m, maps.grid.y_m
path = jaxurban.plan(maps, start_xy_m=(x_m[0], y_m[0]), goal_xy_m=(x_m[-1], y_m[-1]), altitude_m=20.0, snap=True)
assert path.status.has_path, path.status
assert len(jaxurban.sample_city("shinjuku").buildings) > 50_000
print("the wheel works from an empty folder")
PY
