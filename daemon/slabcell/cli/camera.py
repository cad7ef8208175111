"""`slabcell camera`: find cameras, look at one, set one, take a picture, and measure how well pictures arrive."""

import asyncio
import json
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import Annotated, Any, Final

import structlog
import typer

from slabcell.cli.camera_report import (
    device_document,
    feature_document,
    print_devices,
    print_features,
    print_stream_report,
)
from slabcell.cli.files import write_file
from slabcell.errors import (
    ConfigurationError,
    SlabcellError,
    TemporaryError,
    UnavailableError,
    UsageError,
)
from slabcell.images import encode_image
from slabcell_drivers.camera import (
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraLost,
    CameraTimeout,
    ImageFrame,
)
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_device import AravisDevice
from slabcell_drivers.camera.aravis_features import Feature, FeatureKind
from slabcell_drivers.camera.aravis_library import AravisError, AravisLibrary, AravisMissingError
from slabcell_drivers.camera.discovery import Interface, discover, find_camera, force_ip, interfaces
from slabcell_drivers.camera.gvcp import Device, Status
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.camera.stream_test import StreamReport, advise, look_at_path, measure_stream

__all__ = ["camera_app"]

camera_app = typer.Typer(help="Find, set and test cameras.", no_args_is_help=True)

MOVE_S: Final = 5.0
"""A camera that was given an address answers from there by then."""

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
CameraName = Annotated[
    str, typer.Argument(metavar="CAMERA", help="IPv4 address, serial number, MAC address or user-defined name.")
]
InterfaceName = Annotated[
    str | None, typer.Option("--interface", metavar="NAME", help="Look only on this network interface.")
]
Exposure = Annotated[float | None, typer.Option("--exposure-us", metavar="US", help="Exposure time.")]
Gain = Annotated[float | None, typer.Option("--gain-db", metavar="DB", help="Gain.")]
PacketSize = Annotated[
    int | None, typer.Option("--packet-size", metavar="BYTES", help="Packet size; the default finds the largest.")
]
PacketDelay = Annotated[
    int | None, typer.Option("--packet-delay-ns", metavar="NS", help="Pause between packets; the default decides.")
]


@camera_app.callback()
def _group() -> None:
    """Keep the drivers' warnings out of the output, which may be JSON."""
    structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))


@camera_app.command("list")
def list_command(interface: InterfaceName = None, *, as_json: AsJson = False) -> None:
    """List every GigE Vision camera that answers on the network.  Needs no camera library."""
    found = discover(on=_on(interface))
    if as_json:
        typer.echo(json.dumps({"schema": "slabcell.camera-list/1", "cameras": [device_document(d) for d in found]}))
        return
    if not found:
        typer.echo("no camera answers; check power, cable and that UDP port 3956 may pass the firewall")
        return
    print_devices(found)


@camera_app.command("info")
def info_command(
    camera: CameraName,
    features: Annotated[list[str] | None, typer.Argument(metavar="FEATURE...", help="Only these features.")] = None,
    interface: InterfaceName = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Print a camera's features with their values and ranges; a camera in use may be looked at too."""
    device = _find(camera, interface)
    with _opened(device, control=False) as opened:
        found = [opened.features.describe(name) for name in features] if features else opened.features.all()
    if as_json:
        document = {
            "schema": "slabcell.camera-info/1",
            "camera": device_document(device),
            "features": [feature_document(feature) for feature in found],
        }
        typer.echo(json.dumps(document))
        return
    print_features(found)


@camera_app.command("set")
def set_command(
    camera: CameraName,
    assignments: Annotated[
        list[str], typer.Argument(metavar="NAME=VALUE...", help="Features in the order to set them; a command is NAME.")
    ],
    interface: InterfaceName = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Set features by their GenICam names and read them back.  The camera keeps them until it is switched off."""
    device = _find(camera, interface)
    with _opened(device, control=True) as opened:
        done: list[Feature] = []
        for assignment in assignments:
            name, equals, value = assignment.partition("=")
            if not name or (not equals and opened.features.kind(name) is not FeatureKind.COMMAND):
                raise UsageError(f"'{assignment}' sets nothing: write NAME=VALUE; only a command is a NAME alone")
            opened.features.set(name, value)
            done.append(opened.features.describe(name))
    if as_json:
        features = [feature_document(feature) for feature in done]
        typer.echo(json.dumps({"schema": "slabcell.camera-set/1", "features": features}))
        return
    for feature in done:
        typer.echo(f"{feature.name} = {feature.value}" if feature.value is not None else f"{feature.name} done")


@camera_app.command("grab")
def grab_command(
    camera: CameraName,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.png", help="Where the picture goes.")] = Path(
        "picture.png"
    ),
    exposure_us: Exposure = None,
    gain_db: Gain = None,
    pixel_format: Annotated[
        str | None, typer.Option("--pixel-format", metavar="NAME", help="Mono8, Mono12p, BayerRG8, RGB8, ...")
    ] = None,
    packet_size: PacketSize = None,
    timeout_s: Annotated[float, typer.Option("--timeout-s", min=0.1, max=600)] = 5.0,
    interface: InterfaceName = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Take one picture and write it as PNG, with a JSON file beside it that says how it was taken."""
    settings = CameraSettings(
        exposure_us=exposure_us, gain_db=gain_db, pixel_format=pixel_format, packet_size=packet_size
    )
    device = _find(camera, interface)
    with _named():
        frame = asyncio.run(_grab(AravisCamera(str(device.address), settings), timeout_s))
    document = {
        "schema": "slabcell.picture/1",
        "image": out.name,
        "camera": device_document(device),
        "pixel_format": frame.pixel_format,
        "width": frame.pixels.shape[1],
        "height": frame.pixels.shape[0],
        "frame_id": frame.frame_id,
        "device_timestamp_ns": frame.device_timestamp_ns,
        "latency_ms": (frame.received_s - frame.triggered_s) * 1e3,
    }
    _write(out, frame, document)
    typer.echo(json.dumps(document) if as_json else f"{out}: {document['width']}x{document['height']} pixels")


@camera_app.command("force-ip")
def force_ip_command(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="MAC address, serial number or present address.")],
    address: Annotated[str, typer.Argument(metavar="ADDRESS", help="The IPv4 address that the camera shall take.")],
    subnet: Annotated[str, typer.Option("--subnet", metavar="MASK")] = "255.255.255.0",
    gateway: Annotated[str, typer.Option("--gateway", metavar="IP")] = "0.0.0.0",  # noqa: S104 - "none"
    interface: InterfaceName = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Give a camera an address until it is switched off; it need not be in this host's network.  Needs no library."""
    device = _find(camera, interface)
    new, mask, way = _ipv4(address, "ADDRESS"), _ipv4(subnet, "--subnet"), _ipv4(gateway, "--gateway")
    other = find_camera(str(new), on=_on(interface))
    if other is not None and other.mac != device.mac:
        raise UsageError(f"ADDRESS {new} is taken by camera {other.serial} ({other.mac_text}); choose another")
    status = force_ip(device.mac, new, mask, way, on=_on(interface))
    if status is Status.ACCESS_DENIED:
        raise TemporaryError(f"camera {camera}: a client controls it; close that one first")
    if status is not Status.SUCCESS:
        how = f"answered {status.name}" if status else "did not answer"
        raise UnavailableError(
            f"camera {camera}: did not take {new}, it {how}; the address must be in the network that its cable leads to"
        )
    _wait_for_address(camera, device, new, interface)
    if as_json:
        typer.echo(json.dumps({"schema": "slabcell.camera-force-ip/1", "mac": device.mac_text, "address": str(new)}))
    else:
        typer.echo(f"{device.mac_text}: {device.address} -> {new}; it keeps it until it is switched off")


@camera_app.command("stream-test")
def stream_test_command(
    camera: CameraName,
    duration_s: Annotated[float, typer.Option("--duration-s", min=0.2, max=86_400)] = 10.0,
    packet_size: PacketSize = None,
    packet_delay_ns: PacketDelay = None,
    exposure_us: Exposure = None,
    timeout_s: Annotated[float, typer.Option("--timeout-s", min=0.1, max=60)] = 2.0,
    interface: InterfaceName = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Trigger a camera as fast as it answers, measure what arrives, and say what to change.

    Exit code 1 if a picture was lost.
    """
    settings = CameraSettings(packet_size=packet_size, packet_delay_ns=packet_delay_ns, exposure_us=exposure_us)
    device = _find(camera, interface)
    with _named():
        report = asyncio.run(_stream(device, settings, duration_s, timeout_s))
    lines = advise(report)
    if as_json:
        document = asdict(report) | {"schema": "slabcell.camera-stream-test/1", "advice": lines}
        typer.echo(json.dumps(document | {"megabytes_per_s": report.megabytes_per_s}))
    else:
        print_stream_report(report, lines)
    if report.failed:
        raise typer.Exit(1)


async def _grab(camera: AravisCamera, timeout_s: float) -> ImageFrame:
    try:
        await camera.open(timeout_s)
        return await camera.snap(timeout_s)
    finally:
        await camera.close()


async def _stream(device: Device, settings: CameraSettings, duration_s: float, timeout_s: float) -> StreamReport:
    address = str(device.address)
    camera = AravisCamera(address, settings)
    try:
        await camera.open(10.0)
        seen = await camera.read("GevSCPSPacketSize", "GevSCPD")
        return await measure_stream(
            camera,
            duration_s=duration_s,
            timeout_s=timeout_s,
            packet_size=int(seen["GevSCPSPacketSize"]),
            packet_delay_ns=int(seen["GevSCPD"]),
            path=look_at_path(address),
        )
    finally:
        await camera.close()


@contextmanager
def _opened(device: Device, *, control: bool) -> Generator[AravisDevice]:
    with _named():
        library = AravisLibrary()
        opened = AravisDevice(library, str(device.address), CameraSettings(), CameraStatistics())
        try:
            opened.connect(control=control)
            yield opened
        finally:
            opened.close()


@contextmanager
def _named() -> Generator[None]:
    """Give a camera's errors the exit codes of the command."""
    try:
        yield
    except CameraBusy as error:
        raise TemporaryError(str(error)) from error
    except (CameraLost, CameraTimeout, AravisMissingError) as error:
        raise UnavailableError(str(error)) from error
    except CameraConfigError as error:
        raise ConfigurationError(str(error)) from error
    except (CameraError, AravisError) as error:
        raise SlabcellError(str(error)) from error


def _find(camera: str, interface: str | None) -> Device:
    found = find_camera(camera, on=_on(interface))
    if found is None:
        raise UnavailableError(
            f"camera {camera}: does not answer; `slabcell camera list` shows those that do. Check power, cable, address"
        )
    return found


def _wait_for_address(camera: str, device: Device, wanted: IPv4Address, interface: str | None) -> None:
    """Return when the camera answers from its new address; it may need a moment to go there."""
    deadline_s = time.monotonic() + MOVE_S
    seen: Device | None = None
    while time.monotonic() < deadline_s:
        seen = find_camera(device.mac_text, on=_on(interface))
        if seen is not None and seen.address == wanted:
            return
    where = f"still answers from {seen.address}" if seen else "does not answer any more"
    raise UnavailableError(f"camera {camera}: said that it takes {wanted}, and {where}; switch it off and on")


def _on(name: str | None) -> list[Interface] | None:
    if name is None:
        return None
    chosen = [interface for interface in interfaces() if interface.name == name]
    if not chosen:
        names = ", ".join(interface.name for interface in interfaces())
        raise UsageError(f"--interface {name}: has no IPv4 address here; there are {names}")
    return chosen


def _ipv4(text: str, name: str) -> IPv4Address:
    try:
        return IPv4Address(text)
    except AddressValueError as error:
        raise UsageError(f"{name} {text} is no IPv4 address") from error


def _write(out: Path, frame: ImageFrame, document: dict[str, Any]) -> None:
    write_file(out, encode_image(frame.pixels, str(out)))
    write_file(out.with_suffix(".json"), (json.dumps(document, indent=2) + "\n").encode())
