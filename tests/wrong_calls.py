"""Mistakes of users' scripts, one on each marked line: type checkers are to find them (tests/test_types.py).

Nothing imports or runs this file. The names of metrics are an open set: that call may pass.
"""

import jaxurban as ju

city = ju.sample_city("lower-manhattan")
maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,))
start, goal = (-74.0165, 40.7035), (-73.9900, 40.7290)
path = ju.plan(maps, start, goal, altitude_m=60.0, snap=True)
report = ju.explain(path, maps)
demonstrations = ju.fit.demonstrations(path, maps)
scenario = ju.Scenario.from_toml("sample:lower-manhattan")
region, buildings = scenario.region, scenario.buildings
queries = [(start, goal)]

# Functions
ju.plan(maps, start, goal, altitude_m=60.0, wieghts={"gps": 5.0})  # wrong: misspelt argument
ju.plan(maps, start, goal)  # wrong: missing altitude
ju.plan(maps, ("74.01 W", "40.70 N"), goal, altitude_m=60.0)  # wrong: degrees as text
ju.plan(maps, start, goal, altitude_m=60.0, budget_s="5 s")  # wrong: text for a number
ju.plan(maps, start, goal, altitude_m=60.0, planner="a-star")  # wrong: unknown planner
ju.plan(maps, start, goal, altitude_m=60.0, weights={"gsp": 5.0})  # wrong: misspelt metric
ju.plan_many(maps, start, goal, altitude_m=60.0)  # wrong: one query for a list of them
ju.when(maps, queries, altitude_m=60.0, times=["10:00"])  # wrong: no such argument
ju.build_maps(city, resolution=5.0)  # wrong: name without its unit
ju.build_maps(city, gps={"mask_deg": 10.0})  # wrong: dict for a section
ju.open_maps("out/manhattan", "5m")  # wrong: text for a number
ju.sample_city("lower-manhattan", resolution_m=5.0)  # wrong: argument of another function
ju.City.from_files("town.osm", bounds="-74.02,40.70,-73.98,40.73")  # wrong: text for a tuple
ju.fit.fit_weights(demonstrations, loss="robust")  # wrong: removed option
ju.studies.sensitivity(maps, "out", start)  # wrong: a place for pairs of them
ju.grad.map_inputs(city, maps.grid, altitudes_m=60.0)  # wrong: number for a tuple

# Names of closed sets
ju.plan(maps, start, goal, altitude_m=60.0, heuristic="euclid")  # wrong: unknown heuristic
ju.plan(maps, start, goal, altitude_m=60.0, objective="shortest")  # wrong: unknown objective
ju.plan(maps, start, goal, altitude_m=60.0, cost_model="lines")  # wrong: unknown cost model
ju.plan(maps, start, goal, altitude_m=60.0, preset="papers")  # wrong: unknown preset
ju.CostModel(diagonal="both_free")  # wrong: unknown rule of diagonals
ju.sample_city("shinjyuku")  # wrong: misspelt sample
path.save("mission.plan", end="rtl")  # wrong: unknown end
ju.studies.Study(planners=("rrt",))  # wrong: unknown planner
ju.sky(city, start, 20.0, by="rays")  # wrong: unknown argument
ju.open_maps("out/manhattan", obstacles="center")  # wrong: unknown rule of obstacles
ju.Buildings("town.osm", hanging="slab")  # wrong: unknown kind of hanging
ju.Gps(series="epoch")  # wrong: unknown series

# Sections
ju.Gps(weighting="elevation")  # wrong: removed option
ju.Lidar(field_of_view_deg=30.0)  # wrong: number for a tuple of two
ju.Buildings("town.osm", default_heigth_m=9.0)  # wrong: misspelt setting
ju.Scenario(region=region, buildings=buildings, lidar=4)  # wrong: number for a section
print(scenario.lidar.bemas)  # wrong: misspelt setting

# Results
print(path.lenght_m)  # wrong: misspelt attribute
print(maps.dataset)  # wrong: no such attribute
print(report.extremes)  # wrong: removed attribute
