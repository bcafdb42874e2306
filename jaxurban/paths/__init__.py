"""From maps and weights to paths: cost maps, constraints, plans, and what a path is made of."""
