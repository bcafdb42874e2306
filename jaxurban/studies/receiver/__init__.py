"""A satellite receiver's log against maps that are made at its places and times."""
