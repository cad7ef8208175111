"""For whom does a program ask?  The header in which the HMI names the person who is logged in there.

It is the program's word, not the kernel's: the records name the program's user beside it.
"""

import re
from typing import Final

__all__ = ["PERSON", "PERSON_HEADER"]

PERSON_HEADER: Final = "Slabcell-On-Behalf-Of"
PERSON: Final = re.compile(r"[a-z][a-z0-9._-]{0,31}")
