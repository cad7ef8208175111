"""What stands in the EKI channel files?  ``SlabCell.xml`` and its reverse-role variant, from the schema.

Only elements and attributes of the classic configuration format (EthernetKRL 2.2 to 3.x) are written; the format of
iiQKA.OS2 differs and is not meant.
"""

from xml.sax.saxutils import quoteattr

from slabcell_drivers.robot.eki.schema import HEARTBEAT_ROOT, ROBOT, VIS, Channel

__all__ = ["channel_xml"]


def channel_xml(channel: Channel, *, robot_is_client: bool) -> str:
    """Return the channel file.

    ``robot_is_client``: the robot connects to the cell (the normal role); otherwise the cell connects to the robot.
    """
    external_type = "Server" if robot_is_client else "Client"
    lines = ["<ETHERNETKRL>", "  <CONFIGURATION>", "    <EXTERNAL>"]
    if robot_is_client:
        lines += [f"      <IP>{channel.cell_ip}</IP>", f"      <PORT>{channel.cell_port}</PORT>"]
    lines += [
        f"      <TYPE>{external_type}</TYPE>",
        "    </EXTERNAL>",
        "    <INTERNAL>",
        "      <ENVIRONMENT>Program</ENVIRONMENT>",
        f'      <BUFFERING Mode="FIFO" Limit="{channel.buffering_limit}"/>',
        f'      <BUFFSIZE Limit="{channel.buffer_bytes}"/>',
        f'      <TIMEOUT Connect="{channel.connect_timeout_ms}"/>',
        f'      <ALIVE Set_Flag="{channel.flag_alive}" Ping="{channel.ping_s}"/>',
    ]
    if not robot_is_client:
        lines += [f"      <IP>{channel.robot_ip}</IP>", f"      <PORT>{channel.robot_port}</PORT>"]
    lines += [
        "      <PROTOCOL>TCP</PROTOCOL>",
        '      <MESSAGES Logging="warning" Display="disabled"/>',
        "    </INTERNAL>",
        "  </CONFIGURATION>",
        "  <RECEIVE>",
        "    <XML>",
    ]
    for element in VIS.elements:
        lines.append(f'      <ELEMENT Tag={quoteattr(VIS.path(element))} Type="{element.type.value}"/>')
    lines += [
        f'      <ELEMENT Tag="{VIS.root}" Set_Flag="{channel.flag_received}"/>',
        f'      <ELEMENT Tag="{HEARTBEAT_ROOT}" Set_Flag="{channel.flag_heartbeat}"/>',
        "    </XML>",
        "  </RECEIVE>",
        "  <SEND>",
        "    <XML>",
    ]
    lines += [f"      <ELEMENT Tag={quoteattr(ROBOT.path(element))}/>" for element in ROBOT.elements]
    lines += ["    </XML>", "  </SEND>", "</ETHERNETKRL>"]
    return "\n".join(lines) + "\n"
