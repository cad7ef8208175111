"""A new cell has no calibration: it starts, says so, takes pictures for the first one, and is ready when it has it."""

import json
import zipfile

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.events import FrameTaken
from slabcell.cell.looking import LookError
from slabcell.cell.states import CellState, HeldCause
from slabcell.errors import SlabcellError

pytestmark = pytest.mark.unit


@pytest.fixture
async def new(bench):
    """The bench of a cell that was never calibrated."""
    await bench.stop()
    bench.calibration, given = None, bench.calibration
    bench.bundles = True
    await bench.start()
    bench.given = given
    return bench


async def test_it_starts_and_is_not_ready_and_every_trigger_is_refused_by_number(new):
    assert new.cell.state is CellState.INITIALIZED
    assert new.cell.held is HeldCause.CALIBRATION
    assert new.cell.alarms.has(Fault.CALIBRATION_MISSING)
    assert (await new.robot.hello()).code == 0
    new.cell.alarms.come(Fault.LIGHT_LOST, "a later alarm must not hide the reason")
    assert (await new.robot.trigger()).code == Fault.CALIBRATION_MISSING
    assert (await new.robot.next()).offer is None
    assert new.camera.snaps == 0


async def test_it_takes_pictures_to_calibrate_with_but_looks_for_no_slabs(new):
    await new.cell.snap()
    assert any(isinstance(event, FrameTaken) for event in new.events)
    with pytest.raises(LookError, match="no calibration is in use") as refused:
        await new.cell.look()
    assert refused.value.fault is Fault.CALIBRATION_MISSING
    with pytest.raises(SlabcellError, match="is initialized"):
        await new.cell.verify()


async def test_neither_halting_nor_resuming_nor_another_recipe_makes_it_ready(new):
    await new.cell.halt("a person looks")
    await new.cell.resume()
    assert new.cell.state is CellState.INITIALIZED
    await new.cell.change(recipe=new.recipe)
    assert (new.cell.state, new.cell.held) == (CellState.INITIALIZED, HeldCause.CALIBRATION)


async def test_with_its_first_calibration_it_is_ready_without_a_restart(new):
    await new.cell.change(calibration=new.given)
    assert (new.cell.state, new.cell.held) == (CellState.READY, None)
    assert not new.cell.alarms.has(Fault.CALIBRATION_MISSING)
    await new.robot.hello()
    # What it sees is the vision's matter: these grey pictures show no slab, and the cycle is kept with the calibration.
    assert (await new.robot.trigger()).code != Fault.CALIBRATION_MISSING
    await new.cell.stop()
    (bundle,) = (new.folder / "bundles").rglob("*.zip")
    with zipfile.ZipFile(bundle) as archive:
        assert json.loads(archive.read("calibration.json"))["camera"]["width"] == 64


async def test_a_first_calibration_that_comes_while_halted_counts_when_a_person_resumes(new):
    await new.cell.halt("a person looks")
    await new.cell.change(calibration=new.given)
    assert (new.cell.state, new.cell.held) == (CellState.HALTED, None)
    await new.cell.resume()
    assert new.cell.state is CellState.READY
