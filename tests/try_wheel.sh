#!/bin/sh
# Installs the wheel into an empty environment, as a stranger does, and uses it from an empty folder.
# usage: try_wheel.sh DIST_FOLDER CONSTRAINTS MYPY PYTHON...
set -eu
wheel=$(realpath "$1"/jaxurban-*.whl)
constraints=$(realpath "$2")
mypy=$(cd "$(dirname "$3")" && pwd)/$(basename "$3")
tests=$(realpath "$(dirname "$0")")
script=$tests/typed_user.py
shift 3
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"$@" -m venv "$place/new"
cd "$place"
started=$(date +%s)
new/bin/python -m pip -q --disable-pip-version-check install -c "$constraints" "$wheel"
echo "installed into $(new/bin/python --version) in $(($(date +%s) - started)) s: $(du -sm new | cut -f1) MB"
new/bin/python -m pip --disable-pip-version-check check
new/bin/jaxurban --help > help.txt
new/bin/python "$tests/wheel_links.py" "$tests/.."
"$mypy" --strict --python-executable new/bin/python --cache-dir "$place/types" "$script"
XDG_CACHE_HOME="$place/cache" new/bin/python -W ignore "$script"
echo "the wheel works from an empty folder"
