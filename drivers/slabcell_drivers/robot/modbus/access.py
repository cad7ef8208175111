"""Who may connect, how many at once, and what has been refused?  `Access` is the rule, `Counters` what came of it."""

import ipaddress
from collections.abc import Sequence
from dataclasses import asdict, dataclass

__all__ = ["Access", "Counters"]

_Network = ipaddress.IPv4Network | ipaddress.IPv6Network


@dataclass(slots=True)
class Counters:
    """What a server has seen since it was started."""

    connections: int = 0
    refused_peers: int = 0
    """Connections from an address that is not on the list."""
    refused_limit: int = 0
    """Connections beyond the greatest number."""
    refused_writes: int = 0
    """Writes of a second peer while another one writes."""
    requests: int = 0
    exceptions: int = 0
    """Requests answered by an exception response."""
    malformed: int = 0
    """Frames that ended their connection, or that a serial line brought to nobody."""

    def as_dict(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)


class Access:
    """The list of peers and the limits.

    ``peers`` are addresses or networks (192.168.1.20, 192.168.1.0/24); an empty list means any peer.  Raises ValueError
    for what is neither.
    """

    def __init__(self, peers: Sequence[str] = (), *, max_connections: int = 4, idle_timeout_s: float = 60.0) -> None:
        if max_connections < 1:
            raise ValueError(f"max_connections = {max_connections}: at least 1, or nobody can connect")
        self._networks: tuple[_Network, ...] = tuple(ipaddress.ip_network(peer) for peer in peers)
        self.max_connections = max_connections
        self.idle_timeout_s = idle_timeout_s

    def allows(self, host: str) -> bool:
        """Whether a peer of this address may connect."""
        if not self._networks:
            return True
        address = ipaddress.ip_address(host)
        if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
            address = address.ipv4_mapped
        return any(address in network for network in self._networks)
