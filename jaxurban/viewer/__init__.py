"""The viewer: one page for a notebook, a file and a browser, and what answers it."""
