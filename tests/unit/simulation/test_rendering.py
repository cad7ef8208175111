from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy.special import erf

from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation import Slab, World, load_scene, render_slabs, render_world
from slabcell_drivers.simulation.projection import Projector
from slabcell_drivers.simulation.rendering import irradiance
from slabcell_drivers.simulation.scene import Optics

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "dresden.toml")
CAMERA = replace(
    SCENE.camera,
    width=400,
    height=320,
    cx_px=200.0,
    cy_px=160.0,
    distortion=(0.0,) * 5,
    frame=Frame(0, 0, 1000, 0, 0, 180),
)
PLAIN = Optics(
    unevenness=0.0, contact_shadow=0.0, cast_shadow=0.0, slab_texture=0.0, table_texture=0.0, noise_dn=0.0, shot_dn=0.0
)
BODY = np.array([[-30.0, -22.0], [34.0, -20.0], [29.0, 21.0], [4.0, 6.0], [-25.0, 24.0]])


def slab(x: float = 0.3, y: float = -0.7, a: float = 13.0, *, thickness: float = 1e-6, z: float = 0.0) -> Slab:
    return Slab(0, "slab", BODY, thickness, Frame(x, y, z, a))


def share_of(picture: np.ndarray) -> np.ndarray:
    return (picture.astype(float) - PLAIN.table_dn) / (PLAIN.slab_dn - PLAIN.table_dn)


@pytest.mark.parametrize("angle", [0.0, 13.0, 45.0, 101.0])
@pytest.mark.parametrize("blur", [0.0, 0.5, 0.8, 1.5])
def test_area_and_centroid_of_a_slab_in_the_picture_are_those_of_its_outline(angle: float, blur: float) -> None:
    one = slab(a=angle)
    truth = shapely.Polygon(Projector(CAMERA).pixels(np.column_stack([one.outline, np.zeros(len(BODY))])))

    share = share_of(irradiance(CAMERA, replace(PLAIN, blur_sigma_px=blur), [one]))

    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    centroid = np.array([np.sum(share * u), np.sum(share * v)]) / share.sum()
    assert share.sum() == pytest.approx(truth.area, rel=1e-5)
    assert np.allclose(centroid, (truth.centroid.x, truth.centroid.y), atol=1e-4)


@pytest.mark.parametrize("phase", [0.0, 0.13, 0.25, 0.5, 0.77])
def test_an_edge_along_the_pixel_grid_has_the_profile_of_a_blurred_step(phase: float) -> None:
    body = np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]])
    moved = phase * CAMERA.frame.z_mm / CAMERA.fx_px
    share = share_of(irradiance(CAMERA, PLAIN, [Slab(0, "s", body, 1e-6, Frame(moved, 0.0))]))[CAMERA.height // 2]

    edge = CAMERA.cx_px + (20.0 + moved) * CAMERA.fx_px / CAMERA.frame.z_mm
    fine = np.arange(CAMERA.width)[:, None] + (np.arange(200) + 0.5) / 200 - 0.5
    ideal = np.mean(0.5 * (1 - erf((fine - edge) / PLAIN.blur_sigma_px / np.sqrt(2))), axis=1)
    near = slice(int(edge) - 8, int(edge) + 9)
    slope = np.gradient(ideal)[near]
    shift = (share - ideal)[near] @ slope / (slope @ slope)
    assert np.abs(shift) < 3e-4
    assert np.allclose(share[near], ideal[near], atol=3e-3)


def test_lens_distortion_moves_the_outline_to_where_the_lens_model_says() -> None:
    camera = replace(CAMERA, distortion=(-0.3, 0.1, 0.002, -0.001, 0.0), fx_px=900.0, fy_px=905.0)
    one = slab(x=60.0, y=50.0)
    ring = shapely.Polygon(one.outline).segmentize(0.05).exterior.coords
    dense = np.array(ring)
    truth = shapely.Polygon(Projector(camera).pixels(np.column_stack([dense, np.zeros(len(dense))])))

    share = share_of(irradiance(camera, PLAIN, [one]))

    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    centroid = np.array([np.sum(share * u), np.sum(share * v)]) / share.sum()
    assert np.allclose(centroid, (truth.centroid.x, truth.centroid.y), atol=3e-4)


def test_a_thick_slab_shows_its_upper_face_displaced_and_the_wall_towards_the_middle() -> None:
    optics = replace(PLAIN, wall_dn=90.0)
    body = np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]])
    row = irradiance(CAMERA, optics, [Slab(0, "s", body, 20.0, Frame(35.0, 0.0))])[CAMERA.height // 2]

    def column(x: float, z: float) -> int:
        return round(CAMERA.cx_px + x * CAMERA.fx_px / (1000.0 - z))

    foot, near_rim, far_rim = column(25.0, 0.0), column(25.0, 20.0), column(45.0, 20.0)
    assert foot < near_rim
    assert np.all(row[: foot - 4] == pytest.approx(28.0))
    assert 55 < row[(foot + near_rim) // 2] < 125  # the wall, neither table nor upper face
    assert np.all(row[near_rim + 4 : far_rim - 4] == pytest.approx(175.0))
    assert np.all(row[far_rim + 4 :] == pytest.approx(28.0))


def test_slabs_that_touch_leave_neither_gap_nor_double_light() -> None:
    left = np.array([[-30.0, -10.0], [0.0, -10.0], [3.0, 10.0], [-30.0, 10.0]])
    right = np.array([[0.0, -10.0], [30.0, -10.0], [30.0, 10.0], [3.0, 10.0]])
    where = Frame(0.123, 0.0, 0.0, 7.0)
    optics = replace(PLAIN, seam_shadow=0.0)

    both = irradiance(CAMERA, optics, [Slab(0, "l", left, 8.0, where), Slab(1, "r", right, 8.0, where)])
    whole = np.array([[-30.0, -10.0], [0.0, -10.0], [30.0, -10.0], [30.0, 10.0], [3.0, 10.0], [-30.0, 10.0]])
    one = irradiance(CAMERA, optics, [Slab(0, "w", whole, 8.0, where)])

    assert np.allclose(both, one, atol=0.01)


def test_the_joint_of_touching_slabs_can_be_seen() -> None:
    left = np.array([[-30.0, -10.0], [0.0, -10.0], [0.0, 10.0], [-30.0, 10.0]])
    right = left + np.array([30.0, 0.0])
    row = irradiance(CAMERA, PLAIN, [Slab(0, "l", left, 1.0, Frame()), Slab(1, "r", right, 1.0, Frame())])[160]

    assert 60 < row[int(CAMERA.cx_px)] < 160
    assert row[int(CAMERA.cx_px) + 10] == pytest.approx(175.0)


def test_a_carried_slab_hides_what_is_below_it_and_looks_larger() -> None:
    low, high = slab(), Slab(1, "high", BODY, 10.0, Frame(0.3, -0.7, 200.0, 13.0), tone=0.5)

    below = share_of(irradiance(CAMERA, PLAIN, [low]))
    both = irradiance(CAMERA, replace(PLAIN, wall_dn=175.0), [low, high])

    assert not np.any(both > 0.75 * 175.0)
    assert np.sum(both > 60) > 1.4 * below.sum()


def test_shadows_darken_the_table_only() -> None:
    optics = replace(PLAIN, contact_shadow=0.5, cast_shadow=0.3)
    shaded, plain = (irradiance(CAMERA, each, [slab(thickness=10.0)]) for each in (optics, PLAIN))

    on_slab = plain > 174.99
    assert np.allclose(shaded[on_slab], plain[on_slab], atol=0.5)
    assert (shaded - plain).min() < -8
    assert (shaded - plain).max() < 0.5


def test_noise_has_the_variance_of_read_and_shot_noise() -> None:
    optics = replace(PLAIN, noise_dn=1.5, shot_dn=0.02)
    one, other = (
        render_slabs(CAMERA, optics, [slab()], frame_number=frame).astype(float)[145:175, 185:215] for frame in (1, 2)
    )

    variance = np.var(one - other) / 2
    assert variance == pytest.approx(1.5**2 + 0.02 * 175 + 1 / 12, rel=0.15)


def test_the_same_seed_and_frame_give_the_same_picture() -> None:
    world = World(SCENE, 5)

    first = render_world(world, 7)

    assert first.shape == (1200, 1920)
    assert first.dtype == np.uint8
    assert np.array_equal(first, render_world(world, 7))
    assert not np.array_equal(first, render_world(world, 8))


def test_slabs_out_of_view_or_partly_so_are_no_error() -> None:
    far = slab(x=5000.0)
    edge = slab(x=60.0)

    picture = irradiance(CAMERA, PLAIN, [far, edge])

    assert picture[:, -1].max() > 150
    assert picture[:, 0].max() == pytest.approx(28.0)


def test_a_slab_above_the_camera_is_refused() -> None:
    with pytest.raises(ValueError, match="not below the camera"):
        irradiance(CAMERA, PLAIN, [slab(z=1000.0)])
