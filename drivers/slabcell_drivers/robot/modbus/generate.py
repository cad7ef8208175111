"""Which files follow from the register map, and are they up to date?

``python -m slabcell_drivers.robot.modbus.generate`` rewrites them; with ``--check`` it only says which differ (exit 1).
``--map MAP.toml --csv OUT.csv`` writes the CSV file of a map of your own.
"""

import argparse
import sys
from pathlib import Path

from slabcell_drivers.robot.modbus.map_file import ModbusMapError, load_map
from slabcell_drivers.robot.modbus.reference_page import map_csv, reference_page

__all__ = ["generated_files", "main"]

REPOSITORY = Path(__file__).parents[4]


def generated_files(root: Path) -> dict[Path, str]:
    """Return the text of every generated file below the repository's ``root``.  Raises ModbusMapError."""
    register_map = load_map(root / "config" / "modbus_map.toml")
    return {
        root / "docs" / "reference" / "modbus.md": reference_page(register_map),
        root / "config" / "modbus_map.csv": map_csv(register_map),
    }


def main(arguments: list[str] | None = None) -> int:
    """Write or check the files; returns the exit code."""
    parser = argparse.ArgumentParser(description="Write the files that follow from the Modbus register map.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file differs")
    parser.add_argument("--root", type=Path, default=REPOSITORY, help="the repository's root")
    parser.add_argument("--map", type=Path, help="a map of your own")
    parser.add_argument("--csv", type=Path, help="where its CSV file goes")
    options = parser.parse_args(arguments)
    try:
        files = {options.csv: map_csv(load_map(options.map))} if options.map else generated_files(options.root)
    except ModbusMapError as error:
        sys.stderr.write(f"{error}\n")
        return 78
    if options.map and not options.csv:
        parser.error("--map needs --csv OUT.csv")
    differing = [(path, text) for path, text in files.items() if not path.exists() or path.read_text("utf-8") != text]
    for path, text in differing:
        if options.check:
            sys.stdout.write(f"{path}: differs from the map; run python -m {__spec__.name}\n")
        else:
            path.write_text(text, "utf-8")
            sys.stdout.write(f"{path}: written\n")
    return 1 if differing and options.check else 0


if __name__ == "__main__":
    sys.exit(main())
