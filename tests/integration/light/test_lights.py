"""Every light does the same, simulated or on a line, whatever the line is; what goes over it is the manual's."""

import asyncio
import contextlib
import re
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
import serial
import serial.rfc2217

from slabcell_drivers.camera.protocol import CameraInfo, CameraState, CameraUnlit, ImageFrame
from slabcell_drivers.light import (
    LightConfigError,
    LightLost,
    LightMode,
    LightPlan,
    LightRefused,
    LightSetting,
    LightState,
    LitCamera,
    PresetError,
    SerialLight,
    SimulatedController,
    SimulatedLight,
    load_presets,
)

pytestmark = [
    pytest.mark.integration,
    pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning"),  # pyserial 3.5's rfc2217.py
]

FILE = Path(__file__).parents[3] / "config" / "lights.toml"
PRESETS = load_presets(FILE)
BAUD = 115_200


class LineWithoutModem(serial.Serial):
    """A pseudo-terminal has no modem lines to ask for or to set."""

    cts = dsr = ri = cd = property(lambda self: False)

    def _update_dtr_state(self):
        pass

    _update_rts_state = _update_break_state = _update_dtr_state


class Simulated:
    @contextlib.asynccontextmanager
    async def light(self, preset):
        self.it = SimulatedLight(preset)
        yield self.it
        await self.it.close()

    def hush(self, *, silent):
        self.it.unplugged = silent


class OnLine:
    """A controller on a pseudo-terminal, reached through its device file."""

    @contextlib.asynccontextmanager
    async def light(self, preset):
        async with SimulatedController(preset) as self.controller, self.reached(self.controller) as url:
            light = SerialLight(url, preset, baud_rate=BAUD)
            try:
                yield light
            finally:
                await light.close()

    @contextlib.asynccontextmanager
    async def reached(self, controller):
        yield controller.device

    def hush(self, *, silent):
        self.controller.silent = silent


class OverTcp(OnLine):
    """A serial device server without any protocol of its own: socket://."""

    @contextlib.asynccontextmanager
    async def reached(self, controller):
        async def serve(reader, writer):
            with contextlib.suppress(OSError):
                while data := await reader.read(256):
                    writer.write(controller.feed(data))
            writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        yield f"socket://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        server.close()
        await server.wait_closed()


class OverRfc2217(OnLine):
    """A serial device server that speaks RFC 2217, as pyserial's own example does: rfc2217://."""

    @contextlib.asynccontextmanager
    async def reached(self, controller):
        listener = socket.create_server(("127.0.0.1", 0))
        line = LineWithoutModem(controller.device, BAUD, timeout=0.02)
        ending = threading.Event()

        def serve():
            while not ending.is_set():
                try:
                    peer, _ = listener.accept()
                except OSError:
                    return
                with peer:
                    peer.settimeout(0.02)
                    manager = serial.rfc2217.PortManager(line, Peer(peer))
                    while not ending.is_set():
                        if data := line.read(line.in_waiting or 1):
                            peer.sendall(b"".join(manager.escape(data)))
                        try:
                            got = peer.recv(1024)
                        except TimeoutError:
                            continue
                        except OSError:
                            break
                        if not got:
                            break
                        line.write(b"".join(manager.filter(got)))

        thread = threading.Thread(target=serve, name="rfc2217-server")
        thread.start()
        try:
            yield f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            ending.set()
            listener.shutdown(socket.SHUT_RDWR)
            listener.close()
            await asyncio.to_thread(thread.join)
            line.close()


class Peer:
    def __init__(self, peer):
        self.write = peer.sendall


WAYS = (Simulated, OnLine, OverTcp, OverRfc2217)


@pytest.fixture(params=WAYS, ids=lambda way: way.__name__)
def way(request):
    return request.param()


@pytest.fixture(params=PRESETS.values(), ids=lambda preset: preset.name)
def preset(request):
    return request.param


async def test_a_light_is_set_pulsed_checked_and_turned_off(way, preset):
    async with way.light(preset) as light:
        assert light.state is LightState.CLOSED
        assert (await light.open()).family == preset.title
        assert light.state is LightState.READY
        await light.on(LightSetting(2, 40.0))
        await light.on(LightSetting(1, 50.0, strobe_width_us=200.0))
        if preset.commands.trigger:
            await light.trigger(1)
        await light.check()
        await light.off(2)
    assert light.state is LightState.CLOSED


async def test_what_a_family_cannot_do_is_refused_before_anything_is_sent(way, preset):
    async with way.light(preset) as light:
        await light.open()
        for wrong in (
            LightSetting(0),
            LightSetting(99),
            LightSetting(1, -1.0),
            LightSetting(1, 100.1),
            LightSetting(1, 50.0, strobe_width_us=1e7),
            LightSetting(1, 2000.0, strobe_width_us=200.0),
        ):
            with pytest.raises(LightConfigError, match=re.escape(preset.title)):
                await light.on(wrong)
        if not preset.commands.trigger:
            with pytest.raises(LightConfigError, match="no trigger by command"):
                await light.trigger(1)


async def test_a_controller_that_falls_silent_is_lost_and_comes_back(way, preset):
    async with way.light(preset) as light:
        await light.open()
        await light.on(LightSetting(1, 30.0))
        way.hush(silent=True)
        with pytest.raises(LightLost):
            await light.check()
        assert light.state is LightState.LOST
        with pytest.raises(LightLost):
            await light.on(LightSetting(1, 35.0))
        way.hush(silent=False)
        await light.check()
        assert light.state is LightState.READY


async def test_a_light_that_is_not_open_is_lost(way, preset):
    async with way.light(preset) as light:
        with pytest.raises(LightLost, match="open the light"):
            await light.check()


# ---------------------------------------------------------------------------------------------------- on a line only


async def test_what_goes_over_the_line_is_what_the_manuals_say():
    """VLP-2430-4, section 7: channel 2 to 125 is @01F12500 with the checksum DF.  RTxxx, 12.3.1; VTR1, 10.3.1."""
    val, gardasoft = PRESETS["val-vlp"], PRESETS["gardasoft-rt"]
    assert val.commands_for(LightSetting(2, 100 * 125 / 255))[0] == b"@01F12500DF\r\n"
    assert val.commands_for(LightSetting(1, 0.0, 40.0))[1] == b"@00S010084\r\n".replace(b"84", b"B4")
    assert val.off_commands(4) == [b"@03L000" + b"%02X\r\n" % (sum(b"@03L000") % 256)]
    assert gardasoft.commands_for(LightSetting(3, 45.0)) == [b"RS3,45\r"]
    assert gardasoft.commands_for(LightSetting(1, 250.0, 1500.0, 20.0)) == [b"RT1,1.5,0.02,250\r"]
    assert gardasoft.check_command(1, on=True) == b"VR\r"
    assert gardasoft.trigger_command(2) == b"TR2\r"


async def test_the_controller_s_limits_of_the_manual_hold():
    """RTxxx user manual, 7.2: brighter pulses are shorter."""
    gardasoft = PRESETS["gardasoft-rt"]
    for percent, longest_ms in ((100, 999), (200, 30), (300, 10), (500, 2), (1000, 1)):
        gardasoft.commands_for(LightSetting(1, percent, 1000.0 * longest_ms))
        with pytest.raises(LightConfigError, match=f"{1000 * longest_ms} us"):
            gardasoft.commands_for(LightSetting(1, percent, 1000.0 * longest_ms + 1.0))


async def test_a_controller_that_refuses_says_why_and_is_not_lost(preset):
    way = OnLine()
    async with way.light(preset) as light:
        await light.open()
        way.controller.refuse = "2" if preset.checksum == "none" else "03"
        with pytest.raises(LightRefused, match=r"not recognised|out of range"):
            await light.on(LightSetting(1, 30.0))
        assert light.state is LightState.READY


async def test_a_warning_is_not_an_error():
    way = OnLine()
    async with way.light(PRESETS["gardasoft-rt"]) as light:
        await light.open()
        way.controller.refuse = "5"
        await light.on(LightSetting(1, 30.0, 100.0, 0.0))


async def test_a_damaged_reply_is_asked_for_once_more_where_a_checksum_shows_it():
    way = OnLine()
    async with way.light(PRESETS["val-vlp"]) as light:
        await light.open()
        way.controller.garble = 1
        await light.on(LightSetting(1, 30.0))
        way.controller.garble = 2
        with pytest.raises(LightLost):
            await light.check()


async def test_an_adapter_that_is_pulled_out_is_a_loss(preset):
    way = OnLine()
    async with way.light(preset) as light:
        await light.open()
        way.controller.unplug()
        with pytest.raises(LightLost):
            await light.check()
        with pytest.raises(LightLost, match="cannot be opened"):
            await light.check()


async def test_a_controller_that_was_away_gets_its_settings_again(preset):
    way = OnLine()
    async with way.light(preset) as light:
        await light.open()
        await light.on(LightSetting(1, 30.0))
        way.controller.silent = True
        with pytest.raises(LightLost):
            await light.check()
        way.controller.silent = False
        way.controller.received.clear()
        await light.check()
        settings = [command.decode().strip() for command in preset.commands_for(LightSetting(1, 30.0))]
        assert all(any(setting.startswith(got) for got in way.controller.received) for setting in settings)


def test_a_family_without_a_known_baud_rate_wants_it_named():
    with pytest.raises(LightConfigError, match="baud rate"):
        SerialLight("/dev/ttyS0", PRESETS["val-vlp"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("RS{channel},{percent}", "RS{channel},{percant}", "percant"),
        ('reply_end = ">"', "", "reply_end"),
        ("(?P<error>[0-9]+)", "([0-9]+)", "needs a group"),
        ("(?s)", "(?s)(", "no regular expression"),
        ('checksum = "sum8-hex"', 'checksum = "xor"', "checksum"),
        ("slabcell.lights/1", "slabcell.lights/9", "schema"),
        ("channels = 8", "channels = 0", "channels"),
        ("[val-vlp]", "[val-vlp", "not TOML"),
    ],
)
def test_a_preset_that_is_wrong_is_named(tmp_path, old, new, said):
    text = FILE.read_text()
    assert old in text
    (tmp_path / "lights.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(PresetError, match=said):
        load_presets(tmp_path / "lights.toml")


# -------------------------------------------------------------------------------------------------- with the pictures


class WatchfulCamera:
    """Notes what the light did when it took its picture."""

    state = CameraState.READY

    def __init__(self, light):
        self._light, self.seen, self.closed = light, [], False

    async def open(self, timeout_s):
        return CameraInfo("", "", "1", 2, 2, "Mono8")

    async def snap(self, timeout_s):
        now = asyncio.get_running_loop().time()
        self.seen.append((dict(self._light.shining), self._light.triggers))
        await asyncio.sleep(0.01)
        return ImageFrame(np.zeros((2, 2), np.uint8), "Mono8", 1, now, now)

    async def close(self):
        self.closed = True


@contextlib.asynccontextmanager
async def lit(plan):
    light = SimulatedLight(PRESETS["gardasoft-rt"])
    camera, words = WatchfulCamera(light), asyncio.Queue()
    both = LitCamera(camera, light, plan, words.put_nowait)
    await both.open(1.0)
    assert await words.get() == ""
    try:
        yield both, light, camera, words
    finally:
        await both.close()
    assert camera.closed
    assert not light.shining


SHINE, FLASH = LightSetting(1, 60.0), LightSetting(2, 300.0, 500.0)


async def test_a_continuous_light_shines_from_opening_to_closing():
    async with lit(LightPlan(LightMode.CONTINUOUS, (SHINE,))) as (both, light, camera, _):
        assert light.shining == {1: SHINE}
        await both.snap(1.0)
        assert camera.seen == [({1: SHINE}, 0)]
        assert light.shining == {1: SHINE}


async def test_a_light_with_the_trigger_shines_for_the_picture_only():
    async with lit(LightPlan(LightMode.WITH_TRIGGER, (SHINE,), settle_s=0.0)) as (both, light, camera, _):
        assert not light.shining
        await both.snap(1.0)
        assert camera.seen == [({1: SHINE}, 0)]
        assert not light.shining


async def test_a_strobe_is_ready_before_the_camera_is_triggered_and_pulses_after_it():
    plan = LightPlan(LightMode.STROBE, (FLASH,), trigger_by_command=True)
    async with lit(plan) as (both, light, camera, _):
        await both.snap(1.0)
        assert camera.seen == [({2: FLASH}, 0)]
        assert light.triggers == 1


async def test_without_its_light_there_is_no_picture_and_the_loss_is_told_once():
    async with lit(LightPlan(LightMode.WITH_TRIGGER, (SHINE,), settle_s=0.0)) as (both, light, camera, words):
        light.unplugged = True
        with pytest.raises(CameraUnlit, match="no picture without its light"):
            await both.snap(1.0)
        assert camera.seen == []
        assert "does not answer" in await words.get()
        light.unplugged = False
        await both.snap(1.0)
        assert await words.get() == ""
        assert len(camera.seen) == 1


async def test_a_light_that_is_lost_between_pictures_is_noticed_and_set_again_when_it_is_back():
    async with lit(LightPlan(LightMode.CONTINUOUS, (SHINE,))) as (_, light, _, words):
        light.unplugged = True
        assert "does not answer" in await asyncio.wait_for(words.get(), 30)
        light.shining.clear()
        light.unplugged = False
        assert await asyncio.wait_for(words.get(), 30) == ""
        assert light.shining == {1: SHINE}
