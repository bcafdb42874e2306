"""``python -m jaxurban`` is the command line."""

from jaxurban.cli import main

main()
