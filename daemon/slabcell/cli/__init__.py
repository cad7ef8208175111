"""The `slabcell` command: one module for each group of verbs."""

from slabcell.cli.app import main

__all__ = ["main"]
