"""Runs every benchmark of this folder that needs no real data; each prints its own table."""

import runpy
import sys
from pathlib import Path


def main() -> None:
    """Run the benchmarks in the order of their names."""
    for script in sorted(Path(__file__).parent.glob("*.py")):
        if script.name != Path(__file__).name:
            print(f"\n== {script.stem}")
            sys.argv = [str(script)]
            runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
