"""jaxurban score."""

from pathlib import Path

import click

from jaxurban.cli.common import JSON_FLAG, PATH, print_json
from jaxurban.progress import LOG


@click.command()
@click.argument("bench", metavar="BENCH", type=PATH)
@click.argument("submission", metavar="[SUBMISSION]", type=PATH, required=False)
@click.option(
    "--make",
    is_flag=True,
    help="Make the benchmark in the folder BENCH: maps, queries, bounds, rules.",
)
@click.option(
    "-o",
    "board",
    type=PATH,
    help="CSV file of the board: the method's lines are added, or replaced.",
)
@click.option(
    "--method",
    default="",
    help="Name of the method on the board.  [default: the name of SUBMISSION]",
)
@JSON_FLAG
def score(
    bench: Path, submission: Path | None, make: bool, board: Path | None, method: str, as_json: bool
) -> int:
    """Score SUBMISSION, a CSV file of routes from any planner, on the benchmark in the folder BENCH.

    Every route is checked and its cost computed again; the gap is to a proven lower bound. A route that fails counts as
    an infinite gap, and the exit code stays 0.
    """
    from jaxurban.io.tables import records_of
    from jaxurban.studies import board as benchmark

    if make == (submission is not None):
        raise click.UsageError("give either SUBMISSION, a file of routes, or --make")
    if submission is None:
        LOG.info(
            f"score finished: the queries are in {benchmark.make_benchmark(bench, progress=True)}"
        )
        return 0
    lines, routes = benchmark.score(bench, submission, board, method)
    if as_json:
        tables = {"board": lines, "routes": routes}
        print_json(
            {
                name: records_of(table.replace(float("inf"), float("nan")))
                for name, table in tables.items()
            }
        )
    else:
        print(lines.drop(columns=["bundle"]).to_string(index=False, na_rep=""))
    return 0
