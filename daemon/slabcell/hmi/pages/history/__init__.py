"""What was there?  Cycles with their pictures, jobs with their slabs, and how well slabs were laid."""

from __future__ import annotations

from slabcell.hmi.pages.history import cycles, jobs, placements
from slabcell.hmi.route import Page
from slabcell.hmi.security.roles import Role

__all__ = ["PAGE"]

PAGE = Page("history", "/history", Role.VIEWER, 60, (*cycles.ROUTES, *jobs.ROUTES, *placements.ROUTES))
