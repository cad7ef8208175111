"""The robot over KUKA.EthernetKRL: telegram schema, codec, TCP link, and the files for the controller."""

from slabcell_drivers.robot.eki.link import Direction, EkiServer

__all__ = ["Direction", "EkiServer"]
