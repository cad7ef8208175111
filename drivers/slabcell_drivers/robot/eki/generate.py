"""Which files follow from the telegram schema, and are they up to date?

``python -m slabcell_drivers.robot.eki.generate`` rewrites them; with ``--check`` it only says which differ (exit 1).
"""

import argparse
import sys
from pathlib import Path

from slabcell_drivers.robot.eki.krl_constants import constants_fold, splice
from slabcell_drivers.robot.eki.programs_page import programs_page
from slabcell_drivers.robot.eki.reference_page import reference_page
from slabcell_drivers.robot.eki.schema import CHANNEL
from slabcell_drivers.robot.eki.xml_files import channel_xml

__all__ = ["generated_files", "main"]

REPOSITORY = Path(__file__).parents[4]


def generated_files(root: Path) -> dict[Path, str]:
    """Return the text of every generated file below the repository's ``root``."""
    krl = root / "krl"
    vt_dat = krl / "VT.dat"
    constants = splice(vt_dat.read_text("ascii"), constants_fold(CHANNEL))
    programs = {path.name: path.read_text("ascii") for path in sorted(krl.iterdir()) if path.suffix in {".src", ".dat"}}
    return {
        krl / f"{CHANNEL.name}.xml": channel_xml(CHANNEL, robot_is_client=True),
        krl / f"{CHANNEL.server_name}.xml": channel_xml(CHANNEL, robot_is_client=False),
        vt_dat: constants,
        root / "docs" / "reference" / "eki-channel.md": reference_page(CHANNEL),
        root / "docs" / "reference" / "robot-programs.md": programs_page({**programs, vt_dat.name: constants}),
    }


def main(arguments: list[str] | None = None) -> int:
    """Write or check the files; returns the exit code."""
    parser = argparse.ArgumentParser(description="Write the files that follow from the EKI telegram schema.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file differs")
    parser.add_argument("--root", type=Path, default=REPOSITORY, help="the repository's root")
    options = parser.parse_args(arguments)
    differing = [
        (path, text)
        for path, text in generated_files(options.root).items()
        if not path.exists() or path.read_text("utf-8") != text
    ]
    for path, text in differing:
        if options.check:
            sys.stdout.write(f"{path}: differs from the schema; run python -m {__spec__.name}\n")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
            sys.stdout.write(f"{path}: written\n")
    return 1 if differing and options.check else 0


if __name__ == "__main__":
    sys.exit(main())
