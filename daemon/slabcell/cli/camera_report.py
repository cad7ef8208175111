"""How do cameras, their features and a stream test look to a person, and as JSON?"""

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from slabcell.cli.talk import make_console
from slabcell_drivers.camera.aravis_features import Feature
from slabcell_drivers.camera.gvcp import Device
from slabcell_drivers.camera.stream_test import StreamReport

__all__ = ["device_document", "feature_document", "print_devices", "print_features", "print_stream_report"]


def device_document(device: Device) -> dict[str, str]:
    """Return what a camera says of itself."""
    return {
        "address": str(device.address),
        "serial": device.serial,
        "vendor": device.vendor,
        "model": device.model,
        "name": device.user_name,
        "mac": device.mac_text,
        "version": device.version,
    }


def feature_document(feature: Feature) -> dict[str, Any]:
    """Return a feature as the camera has it now."""
    return {
        "name": feature.name,
        "category": feature.category,
        "kind": feature.kind.value,
        "access": feature.access,
        "value": feature.value,
        "minimum": feature.minimum,
        "maximum": feature.maximum,
        "increment": feature.increment,
        "choices": list(feature.choices),
    }


def print_devices(devices: tuple[Device, ...]) -> None:
    """Print a table of cameras; addresses by which one may be named are never cut."""
    table = Table("Address", "Serial", "Vendor", "Model", "Name", "MAC", box=SIMPLE_HEAD)
    for column in (table.columns[0], table.columns[1], table.columns[5]):
        column.no_wrap = True
    for column in table.columns[2:5]:
        column.overflow = "fold"
    for device in devices:
        table.add_row(
            str(device.address), device.serial, device.vendor, device.model, device.user_name, device.mac_text
        )
    make_console().print(table)


def print_features(features: Sequence[Feature]) -> None:
    """Print a table of features, by their categories."""
    table = Table("Feature", "Value", "Range", "Access", box=SIMPLE_HEAD)
    table.columns[0].no_wrap = True
    category = ""
    for feature in features:
        if feature.category != category:
            category = feature.category
            table.add_section()
            table.add_row(category, style="bold")
        value = "" if feature.value is None else str(feature.value)
        table.add_row(feature.name, value, _range(feature), feature.access)
    make_console().print(table)


def _range(feature: Feature) -> str:
    if feature.choices:
        return ", ".join(feature.choices)
    if feature.minimum is not None and feature.maximum is not None:
        step = f", step {feature.increment}" if feature.increment and feature.increment > 1 else ""
        return f"{feature.minimum:.10g} to {feature.maximum:.10g}{step}"
    return ""


def print_stream_report(report: StreamReport, advice: list[str]) -> None:
    """Print what was measured, and what to change."""
    seen = report.statistics
    console = Console(highlight=False, soft_wrap=True)
    console.print(
        f"{report.frames} of {report.triggers} pictures in {report.duration_s:.1f} s:"
        f" {report.megabytes_per_s:.1f} MB/s;"
        f" trigger to pixels {report.latency_median_ms:.1f} ms median, {report.latency_p99_ms:.1f} ms p99"
    )
    console.print(
        f"packets of {report.packet_size} bytes, {report.packet_delay_ns} ns apart; {seen.packets_resent} sent again,"
        f" {seen.packets_missing} missing; {seen.incomplete} incomplete frames, {seen.retries} taken again,"
        f" {seen.underruns} without a buffer"
    )
    console.print(f"{report.path.interface}: MTU {report.path.mtu}; net.core.rmem_max {report.path.rmem_max}")
    for line in advice:
        console.print(f"-> {line}", style="yellow", markup=False)
    if not advice:
        console.print("nothing to change")
