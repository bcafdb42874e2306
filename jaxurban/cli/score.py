"""jaxurban score."""

from pathlib import Path

import click

from jaxurban.cli.common import (
    FLAG,
    GIVEN,
    JSON_FLAG,
    PATH,
    finite_records,
    print_json,
)
from jaxurban.progress import LOG


@click.command()
@click.argument("bench", metavar="BENCH", type=PATH)
@click.argument("submission", metavar="[SUBMISSION]", type=GIVEN, required=False)
@FLAG("--make", help="Make the benchmark in the folder BENCH: maps, queries, bounds, rules.")
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
) -> None:
    """Score the routes of any planner on a benchmark.

    SUBMISSION is a CSV file of routes, and BENCH the folder of the benchmark.

    Every route is checked and its cost computed again; the gap is to a proven lower bound. A route that fails counts as
    an infinite gap, and the exit code stays 0.
    """
    # Either the benchmark is made, or a submission is scored.
    if make == (submission is not None):
        raise click.UsageError("give either SUBMISSION, a file of routes, or --make")
    from jaxurban.studies import board as benchmark  # imported here: it takes a second or two

    if submission is None:
        queries = benchmark.make_benchmark(bench, progress=True)
        LOG.info(f"score finished: the queries are in {queries}")
        return
    lines, routes = benchmark.score(bench, submission, board, method)
    if as_json:
        print_json(finite_records({"board": lines, "routes": routes}))
    else:
        print(lines.drop(columns=["bundle"]).to_string(index=False, na_rep=""))
