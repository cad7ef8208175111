"""What does Prometheus read of the cell?  Counters from its events, and gauges that are looked at when asked.

Names follow the conventions of Prometheus: one prefix, base units, ``_total`` for counters; no label has more than a
few dozen values, and none names a part or a job.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, Info, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from slabcell import __version__
from slabcell.catalogue import catalogue
from slabcell.cell import events
from slabcell.cell.records import JobState, OfferState
from slabcell.cell.states import CellState
from slabcell.service.api.context import ApiContext
from slabcell.service.links import LinkState
from slabcell.vision.result import RejectionReason
from slabcell_drivers.robot.protocol import ResultCode

__all__ = ["Metrics"]

_STAGE_BUCKETS: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_RESIDUAL_BUCKETS: Final = (1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3)
_ENDED: Final = frozenset({OfferState.PLACED, OfferState.FAILED, OfferState.VOID, OfferState.UNKNOWN})
_RESULTS: Final[dict[int, str]] = {
    ResultCode.OK: "ok",
    ResultCode.JOB_COMPLETE: "job_complete",
    ResultCode.NOTHING_LEFT: "nothing_left",
}
FIRST_FAULT: Final = 1000
_CAMERA: Final = {
    "frames": "success",
    "incomplete": "missing_packets",
    "timeouts": "timeout",
    "stale": "stale",
}


class Metrics:
    """The metrics of one cell; `see` is subscribed to its events."""

    def __init__(self, context: ApiContext, camera: object) -> None:
        self.registry = registry = CollectorRegistry()
        self._cycles = Counter("slabcell_cycles", "Cycles that ended, by their outcome.", ["result"], registry=registry)
        self._stages = Histogram(
            "slabcell_cycle_stage_duration_seconds",
            "Duration of the stages of a cycle.",
            ["stage"],
            buckets=_STAGE_BUCKETS,
            registry=registry,
        )
        self._total = Histogram(
            "slabcell_cycle_duration_seconds",
            "From trigger to answer.",
            buckets=_STAGE_BUCKETS,
            registry=registry,
        )
        self._residual = Histogram(
            "slabcell_match_residual_meters",
            "Distance between measured edges and fitted outline of located parts, root mean square.",
            buckets=_RESIDUAL_BUCKETS,
            registry=registry,
        )
        self._results = Counter(
            "slabcell_results", "Results that were settled, by what became of them.", ["state"], registry=registry
        )
        self._jobs = Counter("slabcell_jobs", "Jobs that ended, by their state.", ["state"], registry=registry)
        self._rejected = Counter(
            "slabcell_rejected_blobs", "Blobs that the vision refused, by reason.", ["reason"], registry=registry
        )
        self._alarms = Counter("slabcell_alarms", "Alarms that came, by number.", ["number"], registry=registry)
        self._begin()
        Info("slabcell_build", "Version of the daemon.", registry=registry).info({"version": __version__})
        registry.register(_Present(context, camera))

    def _begin(self) -> None:
        """Count from 0 what is known to be counted: of a series that begins with its first event, that one is lost.

        Prometheus sees an increase only between two values.
        """
        for label in (*_RESULTS.values(), "fault", "other"):
            self._cycles.labels(label)
        for state in sorted(_ENDED):
            self._results.labels(state.value)
        for ended in (JobState.COMPLETE, JobState.ABANDONED):
            self._jobs.labels(ended.value)
        for reason in RejectionReason:
            self._rejected.labels(reason.value)
        for number in catalogue():
            self._alarms.labels(str(number))

    def see(self, event: events.Event) -> None:
        """Take an event of the cell."""
        match event:
            case events.CycleEnded(cycle):
                self._cycles.labels(_RESULTS.get(cycle.code, "fault" if cycle.code >= FIRST_FAULT else "other")).inc()
                if "total" in cycle.times_ms:
                    self._total.observe(cycle.times_ms["total"] / 1000)
            case events.StageEnded(stage, duration_ms):
                self._stages.labels(stage).observe(duration_ms / 1000)
            case events.PartsLocated(result):
                for part in result.parts:
                    self._residual.observe(part.residual_mm / 1000)
                for blob in result.rejected:
                    self._rejected.labels(blob.reason.value).inc()
            case events.ResultMoved(offer) if offer.state in _ENDED:
                self._results.labels(offer.state.value).inc()
            case events.JobEnded(job):
                self._jobs.labels(job.state.value).inc()
            case events.AlarmCame(fault, _):
                self._alarms.labels(str(int(fault))).inc()
            case _:
                pass

    def text(self) -> bytes:
        """Return what is served, in the text format of Prometheus."""
        return generate_latest(self.registry)


class _Present(Collector):
    """What is looked at when somebody asks."""

    def __init__(self, context: ApiContext, camera: object) -> None:
        self._context = context
        self._camera = camera

    def collect(self) -> Iterable[Metric]:
        """Return the gauges of this moment, and the counters that others keep."""
        return list(self._metrics())

    def _metrics(self) -> Iterator[Metric]:
        context, cell = self._context, self._context.cell
        up = GaugeMetricFamily("slabcell_link_up", "Whether a device is reached.", labels=["link"])
        for link in context.links.all:
            up.add_metric([link.name.value], float(link.state is LinkState.UP))
        yield up
        state = GaugeMetricFamily("slabcell_state", "1 for the state that the cell is in.", labels=["state"])
        for name in CellState:
            state.add_metric([name.value], float(cell.state is name))
        yield state
        yield GaugeMetricFamily("slabcell_held", "Whether the cell holds.", value=float(cell.held is not None))
        yield GaugeMetricFamily("slabcell_suspended", "Whether it waits.", value=float(cell.suspended is not None))
        standing = GaugeMetricFamily("slabcell_alarms_standing", "Alarms that stand.", labels=["priority"])
        for priority in ("high", "medium", "low"):
            count = sum(alarm.priority.value == priority for alarm in cell.alarms.standing)
            standing.add_metric([priority], float(count))
        yield standing
        uptime_s = time.monotonic() - context.started_s
        yield GaugeMetricFamily("slabcell_uptime_seconds", "Since the daemon started.", value=uptime_s)
        listening = float(context.seats.taken)
        yield GaugeMetricFamily("slabcell_event_clients", "Clients that listen to events.", value=listening)
        dropped = float(context.seats.dropped)
        yield CounterMetricFamily("slabcell_event_clients_dropped", "Event clients that did not read.", value=dropped)
        refused = float(context.robot.refused_peers)
        yield CounterMetricFamily("slabcell_robot_peers_refused", "Connections that were turned away.", value=refused)
        lost = float(context.history.lost)
        yield CounterMetricFamily("slabcell_history_lines_lost", "Lines that could not be written.", value=lost)
        yield from self._frames()

    def _frames(self) -> Iterator[Metric]:
        statistics = getattr(self._camera, "statistics", None)
        if statistics is None:  # a replay and a simulated camera count nothing
            return
        frames = CounterMetricFamily("slabcell_camera_frames", "Pictures, by what became of them.", labels=["status"])
        for name, status in _CAMERA.items():
            frames.add_metric([status], float(getattr(statistics, name)))
        yield frames
        reconnects = float(statistics.reconnects)
        yield CounterMetricFamily("slabcell_camera_reconnects", "Times the camera was brought back.", value=reconnects)
        resent = float(statistics.packets_resent)
        yield CounterMetricFamily("slabcell_camera_packets_resent", "Packets that came again.", value=resent)
