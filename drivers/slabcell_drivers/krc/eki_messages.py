"""Which messages does EthernetKRL give?  Numbers and texts as a public list of KSS messages has them."""

from enum import IntEnum

__all__ = ["EKI_MESSAGE_TEXTS", "EkiMessage"]


class EkiMessage(IntEnum):
    """EKI_STATUS.MSG_NO."""

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
    XML_INVALID = 22
    ALREADY_INITIALIZED = 23
    ARRAY_NOT_INITIALIZED = 26
    ARRAY_TOO_SMALL = 27
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
    EkiMessage.SERVER_NOT_CREATED: "Create server failed",
    EkiMessage.NOT_ESTABLISHED: "Ethernet connection to external system failed",
    EkiMessage.EMPTY_MEMORY: "Access to empty element memory",
    EkiMessage.ELEMENT_NOT_FOUND: "Element not found",
    EkiMessage.ASSEMBLY_FAILED: "Assembly of data to send failed",
    EkiMessage.SEND_FAILED: "Send data failed",
    EkiMessage.NOTHING_TO_SEND: "No data to send",
    EkiMessage.TYPE_MISMATCH: "Mismatch in type of data",
    EkiMessage.XML_INVALID: "Error while reading the configuration. XML not valid.",
    EkiMessage.ALREADY_INITIALIZED: "Initialization already performed",
    EkiMessage.ARRAY_NOT_INITIALIZED: "FRAME array not initialized",
    EkiMessage.ARRAY_TOO_SMALL: "CHAR[] Array too small.",
    EkiMessage.CONNECTION_LOST: "Ethernet connection disrupted",
    EkiMessage.PING_FAILED: "Ping reports no contact",
    EkiMessage.RECEIVED_XML_INVALID: "Error while reading received XML data",
    EkiMessage.BUFFER_LIMIT: "Limit of element storage reached",
    EkiMessage.STRING_TOO_LONG: "Received string too long",
    EkiMessage.MEMORY_LIMIT: "Limit of element memory reached",
    EkiMessage.SERVER_TIME_LIMIT: "Server time limit reached",
}
"""The text that EKI_CHECK shows."""
