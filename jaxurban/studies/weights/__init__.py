"""What would change a route, and what would not: shares of the cost, breakpoints, regrets."""
