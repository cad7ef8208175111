"""What does the camera in software tell GenICam about itself?  Its features as an XML register description.

The order of elements inside a node is the schema's (EMVA, GenApi 1.1); the reference implementation insists on it.
"""

from collections.abc import Iterable
from xml.sax.saxutils import escape, quoteattr

from slabcell_drivers.simulation.gige.features import Feature, Kind

__all__ = ["describe"]


def describe(vendor: str, model: str, features: Iterable[Feature]) -> bytes:
    """Return the XML file of a camera with these features, UTF-8."""
    features = tuple(features)
    categories = dict.fromkeys(feature.category for feature in features)
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        (
            f"<RegisterDescription ModelName={quoteattr(_identifier(model))}"
            f" VendorName={quoteattr(_identifier(vendor))}"
            ' ToolTip="A GigE Vision camera in software" StandardNameSpace="GEV" SchemaMajorVersion="1"'
            ' SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"'
            ' ProductGuid="5A1ABCE1-0000-4000-8000-000000000001" VersionGuid="5A1ABCE1-0000-4000-8000-000000000002"'
            ' xmlns="http://www.genicam.org/GenApi/Version_1_1"'
            ' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
            ' xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1'
            ' http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd">'
        ),
        '<Category Name="Root" NameSpace="Standard">',
        *(f"<pFeature>{name}</pFeature>" for name in categories),
        "</Category>",
    ]
    for category in categories:
        parts.append(f'<Category Name="{category}" NameSpace="Standard">')
        parts += [f"<pFeature>{feature.name}</pFeature>" for feature in features if feature.category == category]
        parts.append("</Category>")
    for feature in features:
        parts += _node(feature)
    parts += ['<Port Name="Device" NameSpace="Standard"></Port>', "</RegisterDescription>"]
    return "\n".join(parts).encode()


def _identifier(text: str) -> str:
    """Return text as the schema allows it in a name: letters, digits, underscores."""
    return "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in text) or "_"


def _node(feature: Feature) -> list[str]:
    register = f"{feature.name}Reg"
    tooltip = f"<ToolTip>{escape(feature.tooltip)}</ToolTip>" if feature.tooltip else ""
    start = f'<{feature.kind.value} Name="{feature.name}" NameSpace="Standard">{tooltip}'
    end = f"</{feature.kind.value}>"
    unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
    match feature.kind:
        case Kind.STRING:
            start = f'<StringReg Name="{feature.name}" NameSpace="Standard">{tooltip}'
            return [f"{start}{_place(feature)}</StringReg>"]
        case Kind.INTEGER:
            limits = f"<Min>{int(feature.minimum)}</Min><Max>{int(feature.maximum)}</Max><Inc>{feature.increment}</Inc>"
            body = f"<pValue>{register}</pValue>{limits}{unit}"
        case Kind.FLOAT:
            limits = f"<Min>{feature.minimum:.6f}</Min><Max>{feature.maximum:.6f}</Max>"
            body = f"<pValue>{register}</pValue>{limits}{unit}"
            return [
                f"{start}{body}{end}",
                f'<FloatReg Name="{register}">{_place(feature)}<Endianess>BigEndian</Endianess></FloatReg>',
            ]
        case Kind.BOOLEAN:
            body = f"<pValue>{register}</pValue><OnValue>1</OnValue><OffValue>0</OffValue>"
        case Kind.COMMAND:
            body = f"<pValue>{register}</pValue><CommandValue>{feature.command_value}</CommandValue>"
        case Kind.ENUMERATION:
            entries = "".join(
                f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'
                for name, value in feature.entries
            )
            body = f"{entries}<pValue>{register}</pValue>"
    return [f"{start}{body}{end}", _integer_register(register, feature)]


def _place(feature: Feature) -> str:
    return (
        f"<Address>0x{feature.address:X}</Address><Length>{feature.length}</Length>"
        f"<AccessMode>{feature.access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
    )


def _integer_register(name: str, feature: Feature) -> str:
    coding = "<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
    if feature.bits is None:
        return f'<IntReg Name="{name}">{_place(feature)}{coding}</IntReg>'
    first, last = feature.bits
    where = f"<Bit>{first}</Bit>" if first == last else f"<LSB>{last}</LSB><MSB>{first}</MSB>"
    return f'<MaskedIntReg Name="{name}">{_place(feature)}{where}{coding}</MaskedIntReg>'
