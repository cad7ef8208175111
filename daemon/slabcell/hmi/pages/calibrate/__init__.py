"""Lens, table, hand and eye: collect views of a board, compute, compare, activate; and see whether it still holds."""

from __future__ import annotations

from slabcell.hmi.pages.calibrate import checks, history, results, wizard
from slabcell.hmi.route import Page
from slabcell.hmi.security.roles import Role

__all__ = ["PAGE"]

ROUTES = (*wizard.ROUTES, *results.ROUTES, *history.ROUTES, *checks.ROUTES)
PAGE = Page("calibrate", "/calibrate", Role.VIEWER, 40, ROUTES)
