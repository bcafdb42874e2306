"""What would change a route, and what would not: gradients, breakpoints, Sobol indices, Pareto fronts."""
