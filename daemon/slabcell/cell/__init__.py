"""The cell: its states, its cycle, its ledger.  Knows devices by protocol only."""
