"""``python -m slabcell``: the command, for launchers that know only the interpreter."""

from slabcell.cli import main

if __name__ == "__main__":
    main()
