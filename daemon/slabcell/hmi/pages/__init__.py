"""Which pages are there?  One folder each: its routes, its templates, its words.  A new page is one more line here."""

from slabcell.hmi.pages import account, overview, shell, users
from slabcell.hmi.route import Page

__all__ = ["PAGES"]

PAGES: tuple[Page, ...] = (
    overview.PAGE,
    users.PAGE,
    account.PAGE,
    shell.PAGE,
)
