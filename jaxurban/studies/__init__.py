"""Studies of weights: fitting them from routes, and what routes do as they change."""
