"""`python -m fingerflow` is the command `fingerflow`."""

from fingerflow.cli import main

if __name__ == "__main__":
    main()
