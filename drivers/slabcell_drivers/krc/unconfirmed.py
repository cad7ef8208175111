"""What do we assume of the controller that no public source confirms?  Every such number, text and rule, and no other.

Each is to be checked on a real KR C4.  The page ``docs/reference/eki-emulation.md`` lists them for people; a test
compares the two.
"""

from enum import IntEnum

__all__ = ["ASSUMPTIONS", "EKI_MESSAGE_TEXTS", "SINGULAR_A5_DEG", "EkiMessage", "MotionMessage"]

SINGULAR_A5_DEG = 0.01822
"""Below this magnitude of A5 the controller takes the wrist for singular."""


class MotionMessage(IntEnum):
    """Numbers of motion messages.  The controller's own numbers are not public; these are ours, above its range."""

    AXIS_LIMIT = 90001
    UNREACHABLE = 90002
    SINGULARITY = 90003
    AXIS_SPEED = 90004
    CIRCLE = 90005
    VALUE = 90006


class EkiMessage(IntEnum):
    """Numbers of EthernetKRL messages, from memory of the 2.2 manual's message chapter.

    6, 9, 15, 23, 512 and 1792 are supported by titles of public pages, the others by nothing.
    """

    NONE = 0
    FILE_ACCESS_FAILED = 3
    CONFIGURATION_INVALID = 6
    CONNECTION_NOT_AVAILABLE = 9
    DISCONNECTED = 10
    SERVER_NOT_CREATED = 12
    NOT_ESTABLISHED = 14
    EMPTY_MEMORY = 15
    ELEMENT_NOT_FOUND = 16
    ASSEMBLY_FAILED = 17
    SEND_FAILED = 18
    NOTHING_TO_SEND = 19
    TYPE_MISMATCH = 20
    ALREADY_INITIALIZED = 23
    CONNECTION_LOST = 512
    PING_FAILED = 768
    RECEIVED_XML_INVALID = 1024
    BUFFER_LIMIT = 1280
    STRING_TOO_LONG = 1536
    MEMORY_LIMIT = 1792
    SERVER_TIME_LIMIT = 2048


EKI_MESSAGE_TEXTS: dict[EkiMessage, str] = {
    EkiMessage.FILE_ACCESS_FAILED: "File access failed",
    EkiMessage.CONFIGURATION_INVALID: "Interpretation of configuration failed",
    EkiMessage.CONNECTION_NOT_AVAILABLE: "Connection not available",
    EkiMessage.DISCONNECTED: "Ethernet is disconnected",
    EkiMessage.SERVER_NOT_CREATED: "Creating the server failed",
    EkiMessage.NOT_ESTABLISHED: "Connection could not be established",
    EkiMessage.EMPTY_MEMORY: "Access to empty element memory",
    EkiMessage.ELEMENT_NOT_FOUND: "Element not found",
    EkiMessage.ASSEMBLY_FAILED: "Assembly of the data to be sent failed",
    EkiMessage.SEND_FAILED: "Sending the data failed",
    EkiMessage.NOTHING_TO_SEND: "No data to send",
    EkiMessage.TYPE_MISMATCH: "Mismatch in type of data",
    EkiMessage.ALREADY_INITIALIZED: "Initialization already performed",
    EkiMessage.CONNECTION_LOST: "Ethernet connection destroyed",
    EkiMessage.PING_FAILED: "Ping reports no contact",
    EkiMessage.RECEIVED_XML_INVALID: "Error in received XML data",
    EkiMessage.BUFFER_LIMIT: "Limit of element storage reached",
    EkiMessage.STRING_TOO_LONG: "Received string too long",
    EkiMessage.MEMORY_LIMIT: "Limit of element memory reached",
    EkiMessage.SERVER_TIME_LIMIT: "Server time limit reached",
}
"""The text that EKI_CHECK shows.  Wording from memory; titles of public pages support 6, 9, 15, 23 and 1792."""

ASSUMPTIONS: dict[str, str] = {
    "default-role": "EXTERNAL TYPE is Server if it is not given.",
    "buff-after-get": "EKI_STATUS.Buff after EKI_Get is the number of values that are left in that memory.",
    "read-count": "EKI_STATUS.Read is the number of values read: 1 for a single value, n for an array, 6 for no frame.",
    "check-of-node": "EKI_CheckBuffer on a node without a memory of its own counts its attributes (the least), or else "
    "all below it (the most).",
    "lost-connection-number": "Send on a closed connection reports 10; a connection that broke is reported as 512.",
    "unknown-send-path": "EKI_Send with text that is no configured path sends that text as it is.",
    "type-mismatch-received": "A received value that does not read as its type is dropped and reported as 1024.",
    "garbage-received": "Received bytes that are no XML are dropped and reported as 1024; the connection stays.",
    "unknown-elements": "Received elements that are not configured are dropped and noted.",
    "overflow-rest": "After an overflow the rest of the same telegram is still stored, no memory beyond limit + 1.",
    "second-client": "A server with a client refuses the next one by closing it.",
    "singular-target": "At a target with A5 at zero A4 stays where it is ($SINGUL_POS[3] = 1).",
    "frame-attributes": "A received FRAME element without one of its attributes has 0 there.",
    "no-retry": "A client whose connection is refused does not try again within TIMEOUT.",
    "unset-attribute-elements": "An element that has only attributes, none of them set, is left out of a telegram.",
    "real-format": "REAL is written with six decimals.",
    "turn-near-zero": "PTP disregards a turn bit of an axis that is within 2 degrees of zero.",
    "string-limit": "A received STRING has at most 3600 characters.",
    "ping-is-seconds": "The Ping attribute of ALIVE is in seconds.",
    "status-bits": "Status bit 0 set and bit 1 clear mean what the manual's words suggest; no taught points had them.",
    "axis-acceleration": "Every axis reaches its full speed in 0.25 s; accelerations of the arms are not public.",
    "singular-limit": "The wrist is singular below 0.01822 degrees of A5.",
    "motion-numbers": "Messages of motion errors carry numbers of our own.",
    "eki-numbers": "Numbers and texts of EthernetKRL messages are from memory, except the six that pages support.",
}
"""Every assumption by name, one sentence each."""
