"""Who is told what happens?  Turns the cell's events into items of the event ring and lines of the history.

Events come while the robot waits: what they say is put into words when somebody reads them.
"""

from __future__ import annotations

import json
from typing import Any

from slabcell.cell import events
from slabcell.cell.records import OfferRecord
from slabcell.service.api.ring import EventRing
from slabcell.service.api.views import cycle_view, link_view, offer_view, placement_view
from slabcell.service.frames import FrameStore
from slabcell.service.history import CycleRow, History
from slabcell.service.links import Link, Links

__all__ = ["KINDS", "EventFeed"]

KINDS = {
    "state": "the cell went from one state to another, and why",
    "job": "a job began or ended",
    "frame": "a picture was taken",
    "located": "the vision has finished with a picture",
    "stage": "a stage of the cycle has finished",
    "offer": "a result is about to be told to the robot",
    "result": "a result has a new state in the ledger",
    "verified": "laid slabs were measured",
    "cycle": "a cycle ended",
    "kept": "a cycle that ended was written to its bundle",
    "alarm": "an alarm came, went, or was acknowledged, shelved or unshelved",
    "link": "a device is reached, or no longer",
    "task": "work beside the cell began, went on or ended",
    "config": "the configuration was read anew",
    "reset": "events before this one are lost to you: read the state anew",
}
"""Every kind of event, and when it comes."""


class EventFeed:
    """Subscribes to one cell; a link tells it of its changes too."""

    def __init__(self, ring: EventRing, history: History, links: Links, frames: FrameStore) -> None:
        self._ring = ring
        self._history = history
        self._links = links
        self._frames = frames

    def add(self, kind: str, content: dict[str, Any]) -> None:
        """Add an event of the service itself; its content must not change any more."""
        self._ring.add(kind, lambda: json.dumps(content, allow_nan=False))

    def link_changed(self, link: Link) -> None:
        """Tell of a link's new state."""
        self.add("link", link_view(self._links, link).model_dump(mode="json"))

    def see(self, event: events.Event) -> None:
        """Take an event of the cell."""
        match event:
            case events.StateChanged(before, after, cause):
                self.add("state", {"before": before.value, "state": after.value, "cause": cause})
            case events.JobBegan(job) | events.JobEnded(job):
                self.add("job", {"job": job.job_id, "state": job.state.value, "recipe": job.recipe, "slots": job.slots})
            case events.FrameTaken(frame):
                self._frames.show(frame)
                height, width = frame.pixels.shape[:2]
                self.add("frame", {"frame": frame.frame_id, "width": width, "height": height})
            case events.PartsLocated(result):
                self._frames.located(result)
                slots = sorted(part.slot for part in result.parts)
                self.add("located", {"slots": slots, "rejected": len(result.rejected), "empty": [*result.empty_slots]})
            case events.StageEnded(stage, duration_ms):
                self.add("stage", {"stage": stage, "duration_ms": round(duration_ms, 3)})
            case events.Offered(offer):
                self._ring.add("offer", lambda: _offer_json(offer))
            case events.ResultMoved(offer):
                self._ring.add("result", lambda: _offer_json(offer))
            case events.Verified(job, placements, final):
                found = [placement_view(item).model_dump(mode="json") for item in placements]
                self.add("verified", {"job": job.job_id, "final": final, "placements": found})
            case events.CycleEnded(cycle):
                self._ended(cycle)
            case events.CycleKept(cycle, file):
                self._history.set_bundle(cycle.number, file)
                self.add("kept", {"cycle": cycle.number, "bundle": file})
            case events.AlarmCame(fault, detail):
                self._history.alarm_came(int(fault), detail)
                self.add("alarm", {"number": int(fault), "change": "came", "detail": detail})
            case events.AlarmWent(fault, why):
                self._history.alarm_went(int(fault), why)
                self.add("alarm", {"number": int(fault), "change": "went", "detail": why})
            case events.AlarmChanged(fault):
                self.add("alarm", {"number": int(fault), "change": "changed", "detail": ""})

    def _ended(self, cycle: events.CycleRecord) -> None:
        cycle.number = self._history.next_cycle()
        document = cycle_view(cycle, ended=True).model_dump_json()
        self._history.add_cycle(
            CycleRow(cycle.number, cycle.job_id, cycle.verification, cycle.code, cycle.began_utc, document)
        )
        self._ring.add("cycle", document)


def _offer_json(offer: OfferRecord) -> str:
    return json.dumps({"job": offer.job_id, **offer_view(offer).model_dump(mode="json")}, allow_nan=False)
