"""Readers and writers: the only place that opens files or reads clocks."""
