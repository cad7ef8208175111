"""Which pages are there?  One folder each: its routes, its templates, its words.  A new page is one more line here."""

from slabcell.hmi.pages import (
    about,
    account,
    alarms,
    calibrate,
    doctor,
    history,
    overview,
    run,
    shell,
    templates,
    tune,
    users,
)
from slabcell.hmi.route import Page

__all__ = ["PAGES"]

PAGES: tuple[Page, ...] = (
    overview.PAGE,
    run.PAGE,
    tune.PAGE,
    calibrate.PAGE,
    templates.PAGE,
    history.PAGE,
    alarms.PAGE,
    doctor.PAGE,
    users.PAGE,
    about.PAGE,
    account.PAGE,
    shell.PAGE,
)
