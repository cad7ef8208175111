"""What comes from outside is used or refused in words: pictures, CSV lists, recipes, calibrations, all together.

Each kind runs in a process of its own (`fuzz_inputs`), in which more than 3 GiB of address space or 20 s of processor
time for one case end the run.  All large counts by one command: ``./run test -m slow tests/unit/test_fuzz_inputs.py``.
"""

import json
import secrets
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("fuzz_inputs.py")
# Peak of what the process holds beyond its libraries: a decoded picture and its copies, nothing that adds up.
MAX_GROWTH_MIB = 1024

MANY = 1000
REACHED = dict.fromkeys(("pictures", "templates", "lists", "recipes", "calibrations"), "accepted") | {
    "vision": "located"
}
SHORT = {"pictures": 150, "templates": 150, "lists": 150, "recipes": 100, "calibrations": 150, "vision": 60}
LONG = {
    "pictures": 40_000,
    "templates": 20_000,
    "lists": 20_000,
    "recipes": 12_000,
    "calibrations": 20_000,
    "vision": 6_000,
}


def fuzz(kind: str, cases: int, timeout_s: float) -> None:
    number = secrets.randbelow(10**9)
    print(f"python {PROGRAM.name} {kind} {cases} {number}")
    done = subprocess.run(
        [sys.executable, str(PROGRAM), kind, str(cases), str(number)],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=timeout_s,
        check=False,
    )
    assert done.returncode == 0, f"seed {number}\n{done.stderr[-6000:]}"
    report = json.loads(done.stdout.splitlines()[-1])
    print(report)
    # Hypothesis stops early only where a kind has no more different cases.
    assert report["cases"] >= 0.9 * cases
    # A few dozen pictures drawn at random may all be empty; among very many both ends have been reached.
    assert cases < MANY or {"refused", REACHED[kind]} <= report["outcomes"].keys()
    assert report["grown_mib"] < MAX_GROWTH_MIB


@pytest.mark.unit
@pytest.mark.parametrize("kind", SHORT)
def test_what_comes_from_outside_is_used_or_refused_in_words(kind: str):
    fuzz(kind, SHORT[kind], 110)


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", LONG)
def test_very_much_that_comes_from_outside_is_used_or_refused_in_words(kind: str):
    fuzz(kind, LONG[kind], 7000)
