"""How is the HMI configured?  By the table ``[hmi]`` of the cell's configuration, and the environment of systemd."""

from __future__ import annotations

import os
from pathlib import Path

from slabcell.errors import ConfigurationError
from slabcell.hmi.context import HmiOptions
from slabcell.service.api.client import default_socket
from slabcell.service.config_layers import load_config

__all__ = ["read_options"]


def read_options(path: Path) -> HmiOptions:
    """Return what a configuration file says.  Raises ConfigurationError."""
    cell = load_config(path)
    config = cell.hmi
    state = config.state_directory
    if state is None and os.environ.get("STATE_DIRECTORY"):
        state = Path(os.environ["STATE_DIRECTORY"])
    if state is None and cell.state_directory is not None:
        state = cell.state_directory / "hmi"
    if state is None:
        msg = "no state_directory: name one in [hmi], or start the HMI through systemd, which names one"
        raise ConfigurationError(msg)
    return HmiOptions(
        socket=cell.api.socket or _socket(cell.state_directory),
        state=state,
        host=config.host,
        port=config.port,
        certificate=config.certificate,
        private_key=config.private_key,
        names=tuple(config.names),
        language=config.language,
        live_clients=config.live_clients,
        idle_s=config.idle_minutes * 60.0,
        lifetime_s=config.session_hours * 3600.0,
    )


def _socket(state: Path | None) -> Path:
    """Return where a daemon listens whose configuration names no socket: through systemd, or beside its state."""
    if os.environ.get("SLABCELL_SOCKET") or os.environ.get("STATE_DIRECTORY") or state is None:
        return default_socket()
    return state / "api.sock"
