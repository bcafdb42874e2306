"""The commands of the command line, one a file; heavy modules are imported when a command runs."""
