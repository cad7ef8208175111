"""Which pictures do the pages show?  Makes docs/images/demo.png from what a demo left in its folder.

python docs/pictures.py [DIR]        DIR is what `slabcell demo --scene irregular --out DIR` wrote
"""

import sys
from pathlib import Path

import cv2
import numpy as np

IMAGES = Path(__file__).parent / "images"
PANEL = (620, 470)
STRIP, GAP = 44, 12
# Caption, and the left upper corner of the part that is shown at half size: slabs lie right, the assembly left.
PANELS = {
    "before": ("1  what the camera sees", (630, 20)),
    "overlay": ("2  what the vision finds", (630, 20)),
    "after": ("3  what the robot laid", (60, 170)),
}


def compose(folder: Path) -> np.ndarray:
    """Return the three pictures of a demo side by side, each with its caption, shape (h, w, 3) uint8 BGR."""
    panels: list[np.ndarray] = []
    for name, (caption, (u, v)) in PANELS.items():
        picture = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_COLOR)
        if picture is None:
            sys.exit(f"{folder / name}.png: cannot be read; run `slabcell demo --scene irregular --out {folder}` first")
        part = picture[v : v + 2 * PANEL[1], u : u + 2 * PANEL[0]]
        small = cv2.resize(part, PANEL, interpolation=cv2.INTER_AREA)
        panel = cv2.copyMakeBorder(small, 0, STRIP, 0, GAP, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        place = (4, PANEL[1] + STRIP - 14)
        cv2.putText(panel, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.8, (40, 40, 40), 2, cv2.LINE_AA)
        panels.append(panel)
    return np.hstack(panels)


if __name__ == "__main__":
    source = Path(sys.argv[1] if len(sys.argv) > 1 else "demo-out")
    IMAGES.mkdir(exist_ok=True)
    cv2.imwrite(str(IMAGES / "demo.png"), compose(source), [cv2.IMWRITE_PNG_COMPRESSION, 9])
