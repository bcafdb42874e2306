"""Graph search: the heap of open nodes, bounds by rows and columns, and searches of many queries in JAX."""
