"""How are the tables of the ledger laid out?  One list of steps; the version of a file is how many it has taken.

A step that was released is never edited: a change is one more step at the end.
"""

__all__ = ["MIGRATIONS", "TABLES"]

TABLES = ("sessions", "jobs", "cycles", "offers", "acknowledgements", "placements")
"""In the order in which they refer to each other."""

_V1 = (
    """CREATE TABLE sessions (
        session INTEGER PRIMARY KEY AUTOINCREMENT,
        began_utc TEXT NOT NULL,
        cause TEXT NOT NULL
    ) STRICT""",
    """CREATE TABLE jobs (
        job_id INTEGER PRIMARY KEY AUTOINCREMENT,
        robot_job INTEGER NOT NULL,
        recipe TEXT NOT NULL,
        template_sha256 TEXT NOT NULL,
        slots INTEGER NOT NULL,
        state TEXT NOT NULL CHECK (state IN ('open', 'complete', 'abandoned')),
        began_utc TEXT NOT NULL,
        ended_utc TEXT
    ) STRICT""",
    "CREATE UNIQUE INDEX one_open_job ON jobs ((1)) WHERE state = 'open'",
    """CREATE TABLE cycles (
        cycle_id INTEGER PRIMARY KEY AUTOINCREMENT,
        job_id INTEGER NOT NULL REFERENCES jobs,
        session INTEGER NOT NULL,
        trigger_sequence INTEGER NOT NULL,
        began_utc TEXT NOT NULL,
        UNIQUE (session, trigger_sequence)
    ) STRICT""",
    """CREATE TABLE offers (
        result_id INTEGER PRIMARY KEY AUTOINCREMENT,
        job_id INTEGER NOT NULL REFERENCES jobs,
        cycle_id INTEGER NOT NULL REFERENCES cycles,
        idx INTEGER NOT NULL,
        slot INTEGER NOT NULL,
        state TEXT NOT NULL CHECK (
            state IN ('planned', 'offered', 'accepted', 'grasped', 'placed', 'failed', 'void', 'unknown')),
        score REAL NOT NULL,
        reason TEXT NOT NULL,
        fault INTEGER NOT NULL DEFAULT 0,
        changed_utc TEXT NOT NULL,
        pick_x REAL NOT NULL, pick_y REAL NOT NULL, pick_z REAL NOT NULL,
        pick_a REAL NOT NULL, pick_b REAL NOT NULL, pick_c REAL NOT NULL,
        place_x REAL NOT NULL, place_y REAL NOT NULL, place_z REAL NOT NULL,
        place_a REAL NOT NULL, place_b REAL NOT NULL, place_c REAL NOT NULL
    ) STRICT""",
    """CREATE UNIQUE INDEX one_slab_in_a_slot ON offers (job_id, slot)
        WHERE state IN ('planned', 'offered', 'accepted', 'grasped', 'placed', 'unknown')""",
    "CREATE UNIQUE INDEX one_slab_in_the_hand ON offers ((1)) WHERE state IN ('accepted', 'grasped')",
    """CREATE TABLE acknowledgements (
        acknowledgement_id INTEGER PRIMARY KEY AUTOINCREMENT,
        result_id INTEGER NOT NULL REFERENCES offers,
        state TEXT NOT NULL,
        session INTEGER NOT NULL,
        sequence INTEGER NOT NULL,
        reason TEXT NOT NULL,
        at_utc TEXT NOT NULL
    ) STRICT""",
    """CREATE TABLE placements (
        placement_id INTEGER PRIMARY KEY AUTOINCREMENT,
        job_id INTEGER NOT NULL REFERENCES jobs,
        slot INTEGER NOT NULL,
        found INTEGER NOT NULL,
        dx_mm REAL, dy_mm REAL, da_deg REAL, residual_mm REAL,
        at_utc TEXT NOT NULL
    ) STRICT""",
)

_V2 = (
    "ALTER TABLE jobs ADD COLUMN correction_x_mm REAL NOT NULL DEFAULT 0",
    "ALTER TABLE jobs ADD COLUMN correction_y_mm REAL NOT NULL DEFAULT 0",
)
"""By how much a job is laid otherwise than its template says, to make up for a systematic error."""

_V3 = (
    "CREATE INDEX offers_by_job ON offers (job_id, result_id)",
    "CREATE INDEX cycles_by_job ON cycles (job_id)",
    "CREATE INDEX acknowledgements_by_result ON acknowledgements (result_id)",
    "CREATE INDEX placements_by_job ON placements (job_id, placement_id)",
)
"""So that a request costs the same after a hundred thousand cycles as after ten."""

MIGRATIONS: tuple[tuple[str, ...], ...] = (_V1, _V2, _V3)
