"""The daemon's workshop: builds real things from the configuration and runs them as one cell."""
