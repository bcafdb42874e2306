"""A receiver's log against the city."""
