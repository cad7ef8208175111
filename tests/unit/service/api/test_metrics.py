"""Prometheus reads what happened, by the names that its conventions ask for and the dashboard uses."""

import asyncio
import json
import re
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from slabcell.catalogue import Fault
from slabcell.cell.events import CycleEnded, CycleRecord, StageEnded
from slabcell.service.api.client import ApiClient
from slabcell.service.metrics import Metrics

pytestmark = pytest.mark.unit

DASHBOARD = Path(__file__).parents[4] / "config" / "grafana" / "slabcell.json"
UNITS = ("_seconds", "_meters", "_total", "_info", "_up", "_state", "_held", "_suspended", "_standing", "_clients")


@pytest.fixture
def families(api):
    metrics = Metrics(api, camera=object())
    api.metrics = metrics.text
    end = api.cell.subscribe(metrics.see)
    api.cell.alarms.come(Fault.BUNDLE_UNWRITABLE, "no room")
    for event in (
        StageEnded("acquire", 20.0),
        CycleEnded(CycleRecord(1, 1, 1, 1, times_ms={"total": 42.0})),
        CycleEnded(CycleRecord(2, 1, 1, 2, code=1101)),
    ):
        metrics.see(event)
    end()

    async def read():
        answer = await asyncio.to_thread(ApiClient(api.history._file.path.parent / "api.sock").fetch, "/metrics")
        return {family.name: family for family in text_string_to_metric_families(answer.content.decode())}

    return read


async def test_what_happened_is_counted(families):
    found = await families()
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in found.values()
        for sample in family.samples
    }
    assert samples[("slabcell_cycles_total", "ok")] == 1
    assert samples[("slabcell_cycles_total", "fault")] == 1
    assert samples[("slabcell_cycle_duration_seconds_sum",)] == pytest.approx(0.042)
    assert samples[("slabcell_cycle_stage_duration_seconds_sum", "acquire")] == pytest.approx(0.02)
    assert samples[("slabcell_alarms_total", "1707")] == 1
    assert samples[("slabcell_alarms_standing", "low")] == 1
    assert samples[("slabcell_state", "ready")] == 1


async def test_what_has_not_happened_yet_is_counted_as_none(families):
    # An increase is seen between two values only: a series that begins with its first event would hide that one.
    begun = {
        (sample.name, *sample.labels.values())
        for family in (await families()).values()
        for sample in family.samples
        if sample.value == 0
    }
    for series in (
        ("slabcell_alarms_total", "1101"),
        ("slabcell_cycles_total", "nothing_left"),
        ("slabcell_results_total", "failed"),
        ("slabcell_jobs_total", "complete"),
        ("slabcell_rejected_blobs_total", "slot_taken"),
    ):
        assert series in begun


async def test_names_keep_the_conventions(families):
    for family in (await families()).values():
        if family.name.endswith("_created"):  # the library's own, beside each counter
            continue
        assert re.fullmatch(r"slabcell_[a-z_]+", family.name)
        assert family.documentation.endswith(".")
        name = f"{family.name}_total" if family.type == "counter" else family.name
        name = f"{name}_info" if family.type == "info" else name
        assert name.endswith(UNITS), name


async def test_the_dashboard_asks_for_metrics_that_there_are(families):
    known = {sample.name for family in (await families()).values() for sample in family.samples}
    known |= {family.name + suffix for family in (await families()).values() for suffix in ("_total", "_bucket")}
    known |= {"slabcell_camera_frames_total"}  # of real cameras only
    asked = set(re.findall(r"slabcell_[a-z_]+", json.dumps(json.loads(DASHBOARD.read_text())["panels"])))
    assert asked
    assert asked <= known
