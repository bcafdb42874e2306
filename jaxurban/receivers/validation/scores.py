"""AUC of C/N0 between seen and hidden satellites, under draws of the blocks of a track.

Legend: ``R`` rows of a log, an epoch and a satellite each, ``B`` blocks of the track, ``D`` draws of them, the first
one each block once.
"""

import numpy as np
import pandas as pd

from jaxurban.statistics.bootstrap import draws_of, interval_of, named

LEVEL_DBHZ = 0.1  # to which C/N0 is rounded: no receiver resolves less


def aucs(
    is_seen: np.ndarray,
    level: np.ndarray,
    block: np.ndarray,
    weights: np.ndarray,
    group: np.ndarray | None = None,
) -> np.ndarray:
    """Return ``[D]`` the AUC of C/N0 between seen and hidden rows under each draw of blocks.

    This is the share of pairs of a seen and a hidden row in which the seen row has the higher level; ties count half.
    It is NaN where a draw has no pair.

    Args:
      is_seen: ``[R]`` bool, whether the maps call the satellite seen.
      level: ``[R]`` number of the row's C/N0 among all values, from low to high.
      block: ``[R]`` number of the row's block.
      weights: ``[D, B]`` how often a draw holds each block.
      group: ``[R]`` number of the row's satellite: only rows of one satellite form pairs. None: all rows do.
    """
    # Rows are counted by block and level, so that a draw is a product of matrices.
    num_blocks = weights.shape[1]
    num_levels = int(level.max(initial=0)) + 1
    cell = block * num_levels + level

    def counts(is_counted: np.ndarray) -> np.ndarray:
        """Return ``[B, levels]`` how many of the counted rows each block has of each level."""
        num_rows = np.bincount(cell[is_counted], minlength=num_blocks * num_levels)
        return num_rows.reshape(num_blocks, num_levels)

    # A seen row wins against the hidden rows below its level, and half against those at it.
    wins = np.zeros(len(weights))
    pairs = np.zeros(len(weights))
    if group is None:
        group = np.zeros(len(level))
    for number in np.unique(group):
        is_member = group == number
        seen = weights @ counts(is_member & is_seen)
        hidden = weights @ counts(is_member & ~is_seen)
        below = np.cumsum(hidden, axis=1) - hidden / 2
        wins += (seen * below).sum(axis=1)
        pairs += seen.sum(axis=1) * hidden.sum(axis=1)
    return np.divide(wins, pairs, out=np.full(len(weights), np.nan), where=pairs > 0)


def drawn_blocks(place: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the block of each row, and how often draws of the bootstrap hold each block.

    Args:
      place: ``[R]`` number of each row's block along the track; a row with NaN is in no block.
      seed: of the draws.

    Returns:
      ``[R]`` the blocks, numbered from 0 without gaps, -1 for no block; and ``[D, B]`` the draws, of which the first
      holds each block once.
    """
    block, places = pd.factorize(place, sort=True)
    num_blocks = max(1, len(places))
    return block, np.concatenate([np.ones((1, num_blocks)), draws_of(num_blocks, seed)])


def levels_of(cn0_dbhz: pd.Series) -> np.ndarray:
    """Return ``[R]`` number of each C/N0 among those that occur, from low to high."""
    return pd.factorize(np.round(cn0_dbhz.to_numpy(float) / LEVEL_DBHZ), sort=True)[0]


def score_table(rows: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Return the ``scores`` of a `jaxurban.receivers.validation.validate.ReceiverValidation`.

    Args:
      rows: its rows.
      seed: of the bootstrap over blocks.
    """
    # Which rows each line of the table is of.
    choices = {"all": rows.is_judged, "received": rows.is_judged & (rows.cn0_dbhz > 0)}
    for name in sorted(rows.system.unique()):
        choices[name] = rows.is_judged & (rows.system == name)
    choices["unguarded"] = ~rows.is_inside
    table = []
    for which, is_chosen in choices.items():
        chosen = rows[is_chosen]
        level = levels_of(chosen.cn0_dbhz)
        satellite = chosen.satellite.cat.codes.to_numpy()
        is_seen = chosen.is_seen.to_numpy()
        block, weights = drawn_blocks(chosen.block.to_numpy(), seed)

        # Satellites that are seen at one time and hidden at another have two values.
        num_values = chosen.groupby("satellite", observed=True).is_seen.nunique()
        row = {"which": which, "rows": len(chosen), "share": len(chosen) / len(rows)}
        for name, group in (("auc", None), ("within", satellite)):
            drawn = aucs(is_seen, level, block, weights, group)
            row |= named(name, interval_of(drawn[0], drawn[1:], weights.shape[1]))
        table.append(row | {"num_satellites": int((num_values == 2).sum())})
    return pd.DataFrame(table)
