"""Entry point of `python -m fingerflow.player`, in the folder of a bundle."""

import sys

from fingerflow.player.cli import main

if __name__ == "__main__":
    sys.exit(main(prog=f"python -m {__package__}"))
