"""The Monte Carlo benchmark: sampled queries under every planner, row by row, and what came out."""
