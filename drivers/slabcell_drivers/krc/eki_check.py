"""Would a controller take these channel files?  What EKI_Init would refuse, and what this software does not emulate."""

from collections.abc import Mapping

from slabcell_drivers.krc.eki_config import SERVER_PORTS, EkiConfigError, Role, parse_config
from slabcell_drivers.krc.eki_xml import XmlError, parse_document
from slabcell_drivers.krc.syntax import Diagnostic

__all__ = ["check_channels"]


def check_channels(files: Mapping[str, bytes]) -> list[Diagnostic]:
    """Return what is wrong with the channel files among these, by file and line; other XML files are passed over."""
    found: list[Diagnostic] = []
    for file, raw in files.items():
        if file.lower().endswith(".xml") and _is_channel(raw):
            found += _problems(file, raw)
    return found


def _is_channel(raw: bytes) -> bool:
    try:
        return parse_document(raw).name.upper() == "ETHERNETKRL"
    except XmlError:
        return False  # that it is no XML is for those to say who look at any file


def _problems(file: str, raw: bytes) -> list[Diagnostic]:
    try:
        config = parse_config(raw)
    except EkiConfigError as error:
        return [
            Diagnostic(file, max(1, p.line), 1, "warning" if p.is_ours else "error", "channel-configuration", p.text)
            for p in error.problems
        ]
    if config.role is Role.SERVER and config.internal_port not in SERVER_PORTS:
        text = (
            f"port {config.internal_port}: on the KLI a controller opens {SERVER_PORTS[0]} to {SERVER_PORTS[-1]}; "
            "any other has to be opened in its network configuration (NAT)"
        )
        return [Diagnostic(file, 1, 1, "warning", "channel-port", text)]
    return []
