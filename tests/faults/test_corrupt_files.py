"""Every file that the cell reads, with every region of it flipped or cut: is it refused with its name, or harmless?

Nothing may be another exception than ours, and nothing may be changed by the reading.
"""

import json
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from slabcell.calibration import load_calibration, save_calibration
from slabcell.catalogue import Fault
from slabcell.cell.bundle_file import read_bundle
from slabcell.cell.ledger import LedgerFile
from slabcell.cell.ledger_export import export_document, read_export, restore, write_export
from slabcell.errors import SlabcellError
from slabcell.recipe import load_recipe
from slabcell.service.config_layers import load_config

from .conftest import cell_kit

pytestmark = [pytest.mark.faults, pytest.mark.timeout(300)]

CONFIG = Path(__file__).parents[2] / "config"
REGIONS = 48


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sound file of each kind, in a folder."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("recipes", "templates"):
        shutil.copytree(CONFIG / name, folder / name)
    shutil.copy(CONFIG / "cell.toml", folder / "cell.toml")
    save_calibration(folder / "calibration.json", cell_kit.make_calibration())

    import asyncio

    async def work() -> None:
        bench = cell_kit.Bench(folder)
        bench.bundles = True
        await bench.start()
        await bench.robot.hello()
        await bench.robot.lay_all()
        await bench.stop()

    asyncio.run(work())
    shutil.copy(sorted((folder / "bundles").iterdir())[0], folder / "bundle.zip")
    book = LedgerFile(folder / "ledger.sqlite")
    write_export(folder / "export.json", export_document(book))
    book.close()
    return folder


def use_ledger(path: Path) -> None:
    book = LedgerFile(path)
    try:
        export_document(book)
        book.new_session("test")
    finally:
        book.close()


def use_export(path: Path) -> None:
    target = path.with_suffix(".sqlite")
    restore(target, read_export(path), str(path))
    target.unlink()


KINDS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "configuration": ("cell.toml", load_config),
    "recipe": ("recipes/dresden.toml", load_recipe),
    "template": ("templates/dresden.csv", lambda path: load_recipe(path.parents[1] / "recipes" / "dresden.toml")),
    "calibration": ("calibration.json", load_calibration),
    "ledger": ("ledger.sqlite", use_ledger),
    "export of a ledger": ("export.json", use_export),
    "bundle": ("bundle.zip", read_bundle),
}


def damages(raw: bytes, dice: random.Random) -> Iterator[tuple[str, bytes]]:
    """Give the file cut after each region, and with bits flipped in each, one bit and all of them."""
    step = max(1, len(raw) // REGIONS)
    for start in range(0, len(raw), step):
        yield f"cut after {start} bytes", raw[:start]
        region = bytearray(raw)
        at = start + dice.randrange(min(step, len(raw) - start))
        region[at] ^= 1 << dice.randrange(8)
        yield f"one bit flipped at {at}", bytes(region)
        region = bytearray(raw)
        for index in range(start, min(start + step, len(raw))):
            region[index] ^= 0xFF
        yield f"bytes {start} to {start + step} inverted", bytes(region)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_refused_with_its_name_or_does_no_harm(files, tmp_path, kind):
    name, use = KINDS[kind]
    seed = random.SystemRandom().randrange(1 << 32)
    sys.stdout.write(f"seed {seed}\n")
    dice = random.Random(seed)
    room = tmp_path / "room"
    shutil.copytree(files, room)
    for leftover in room.glob("ledger.sqlite-*"):
        leftover.unlink()
    path = room / name
    use(path)
    raw = (files / name).read_bytes()
    refused = 0
    for what, damaged in damages(raw, dice):
        path.write_bytes(damaged)
        for leftover in room.glob("ledger.sqlite-*"):
            leftover.unlink()
        try:
            use(path)
        except SlabcellError as error:
            refused += 1
            assert str(room) in str(error), what  # noqa: PT017 - some damage is in a comment, and is none
        if kind != "ledger":  # an open ledger is written to
            assert path.read_bytes() == damaged, what
    assert refused > REGIONS  # most damage is found


def test_a_damaged_ledger_keeps_its_number_and_the_daemon_does_not_start(cell):
    with cell.daemon() as daemon:
        assert daemon.stop() == 0
    ledger = cell.folder / "state" / "ledger.sqlite"
    raw = bytearray(ledger.read_bytes())
    raw[0:64] = bytes(64)
    ledger.write_bytes(raw)
    done = cell.run()
    assert done.returncode != 0
    assert f"[{int(Fault.LEDGER_DAMAGED)}]" in done.stderr
    assert "Traceback" not in done.stderr.splitlines()[-1]
    assert ledger.read_bytes() == bytes(raw)  # it is evidence


def test_a_damaged_calibration_stops_the_daemon_before_anything_runs(cell):
    path = cell.folder / "calibration.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document)[:-40])
    done = cell.run()
    assert done.returncode == 78
    assert "calibration.json" in done.stderr
    assert not (cell.folder / "state" / "ledger.sqlite").exists()
