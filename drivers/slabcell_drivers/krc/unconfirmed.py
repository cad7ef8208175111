"""What do we assume of the controller that no public source confirms?  Every such number, text and rule, and no other.

Each is to be checked on a real KR C4.  The page ``docs/reference/eki-emulation.md`` lists them for people; a test
compares the two.
"""

__all__ = ["ASSUMPTIONS", "SINGULAR_A5_DEG"]

SINGULAR_A5_DEG = 0.01822
"""Below this magnitude of A5 the controller takes the wrist for singular."""


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
    "motion-numbers": "Unreachable points and singularities on a path carry message numbers of our own.",
    "uninitialised-target": "EKI_Get into a variable that was never set stops the program with 1422; the manual asks "
    "for initialised variables.",
    "char-array-too-small": "A text longer than the CHAR array of EKI_GetString is taken from its memory, and lost.",
}
"""Every assumption by name, one sentence each."""
