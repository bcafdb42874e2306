# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 9. Many routes, several cities
#
# **Which weights matter, and do two cities agree?**
#
# One route on one map (notebook 6) is an anecdote. A paper needs many routes, altitudes and cities, and intervals that
# say how much of the answer is chance. `ju.studies.sensitivity` draws routes by stratum and range and asks every
# one of them the same questions.
#
# The cities are those of the package, Lower Manhattan and Shinjuku in Tokyo; folders of maps of your own would do as
# well. The first call on a machine compiles for some ten seconds.

# %%
# %matplotlib inline
import shutil
import tempfile
from pathlib import Path

import pandas as pd

import jaxurban as ju
from jaxurban.plot import plot_regret

maps = {
    name: ju.build_maps(
        ju.sample_city(name), resolution_m=10.0, altitudes_m=(20.0, 60.0), progress=False
    )
    for name in ("lower-manhattan", "shinjuku")
}
folder = Path(tempfile.mkdtemp())
pd.set_option("display.max_colwidth", None, "display.max_rows", 100)

# %% [markdown]
# ## The study
#
# Ten pairs of places in each city, each flown at both altitudes. Rows are kept in the folder as they come: interrupt
# it, and the same call goes on. More routes (`30`) narrow every interval.

# %%
found = ju.studies.sensitivity(
    maps,
    folder / "study",
    10,
    progress=False,
)
found.decided

# %% [markdown]
# ## What a wrong weight costs
#
# The route under a weight twice too large or too small, costed by the true weights, over the cheapest: its regret. It
# ranks the weights by what an error in them does.

# %%
summary = found.tables["summary"]
summary[summary.cut == "all"].sort_values("regret", ascending=False)[
    ["weight_name", "routes", "regret", "changes", "share"]
]

# %%
plot_regret(summary, found.settings.wrong)

# %% [markdown]
# ## Shares of the cost
#
# A weight's share of what the cheapest route costs is the gradient of the cost by the logarithm of the weight. It is a
# level, and no measure of importance: a number added to a layer everywhere raises its share and changes no route.

# %%
summary[summary.cut == "city"].pivot(index="weight_name", columns="value", values="share").round(2)

# %% [markdown]
# ## How near the next route is
#
# By which factor a weight may change before half of the cheapest routes become other ones.

# %%
summary[summary.cut == "altitude_m"].pivot(
    index="value", columns="weight_name", values="nearest"
).round(2)

# %% [markdown]
# ## Where a weight matters
#
# The mean regret by what lies below the start.

# %%
found.tables["weights"].pivot_table("regret", "start_stratum", "weight_name").round(4)

# %% [markdown]
# Every number lies in `folder / "study"` as CSV and Parquet, with a report. It can be deleted:

# %%
shutil.rmtree(folder)

# %% [markdown]
# ## A question to try
#
# Do ten more routes in each city narrow an interval? Ask for 20. What would it take to say something of other cities?
