"""The sky in a city: which satellites are seen, hidden or unknown from a place, along a track, beside a log."""
