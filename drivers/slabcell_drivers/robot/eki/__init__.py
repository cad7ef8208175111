"""The robot over KUKA.EthernetKRL: telegram schema, codec, TCP links, and the files for the controller."""

from slabcell_drivers.robot.eki.client import EkiClient
from slabcell_drivers.robot.eki.link import EkiServer
from slabcell_drivers.robot.link_events import Direction, EndReason

__all__ = ["Direction", "EkiClient", "EkiServer", "EndReason"]
