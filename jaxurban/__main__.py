"""``python -m jaxurban`` is the command line."""

from jaxurban.cli.main import main

if __name__ == "__main__":  # worker processes import this module too
    main()
