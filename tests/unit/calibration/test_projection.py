"""Projections have the derivatives that differences show, for every lens model, and directions lead back to pixels."""

import numpy as np
import pytest

from slabcell.calibration.model import Lens
from slabcell.calibration.projection import board_pose, from_vector, normalized, parameter_names, project, to_vector

pytestmark = pytest.mark.unit

MATRIX = np.array([[1666.0, 0, 481], [0, 1665.0, 303], [0, 0, 1]])
LENSES = {
    "brown4": Lens(MATRIX, np.array([-0.12, 0.15, 6e-4, -4e-4])),
    "brown5": Lens(MATRIX, np.array([-0.12, 0.15, 6e-4, -4e-4, 0.02])),
    "brown8": Lens(MATRIX, np.array([-0.12, 0.15, 6e-4, -4e-4, 0.02, 0.01, -0.02, 0.01])),
    "brown14": Lens(
        MATRIX, np.array([-0.12, 0.15, 6e-4, -4e-4, 0.02, 0.01, -0.02, 0.01, 1e-3, 0, 2e-3, 0, 0.01, -0.02])
    ),
    "fisheye": Lens(MATRIX * [[0.25], [0.25], [1.0]], np.array([-0.02, 0.005, -0.002, 3e-4]), "fisheye"),
}
POSE = np.array([2.9, 0.2, -0.3, -60.0, 40.0, 700.0])
POINTS = np.column_stack([np.random.default_rng(0).uniform(0, 180, (20, 2)), np.zeros(20)])


@pytest.fixture(params=LENSES.values(), ids=LENSES.keys())
def lens(request):
    return request.param


def test_derivatives_are_those_of_differences(lens):
    _, by_pose, by_lens = project(POINTS, POSE, lens)
    for n in range(6):
        step = np.zeros(6)
        step[n] = 1e-6 if n < 3 else 1e-3
        change = project(POINTS, POSE + step, lens)[0] - project(POINTS, POSE - step, lens)[0]
        assert np.allclose(by_pose[:, n], change.ravel() / (2 * step[n]), rtol=1e-4, atol=1e-4)
    vector = to_vector(lens)
    assert len(parameter_names(lens)) == len(vector) == by_lens.shape[1]
    for n, value in enumerate(vector):
        step = np.zeros(len(vector))
        step[n] = 1e-6 * max(abs(value), 1e-2)
        ahead, behind = from_vector(vector + step, lens), from_vector(vector - step, lens)
        change = project(POINTS, POSE, ahead)[0] - project(POINTS, POSE, behind)[0]
        assert np.allclose(by_lens[:, n], change.ravel() / (2 * step[n]), rtol=1e-3, atol=1e-3)


def test_directions_lead_back_to_their_pixels(lens):
    pixels, _, _ = project(POINTS, POSE, lens)
    rays = np.column_stack([normalized(pixels, lens), np.ones(len(pixels))])
    again, _, _ = project(rays, np.zeros(6), lens)
    assert np.abs(again - pixels).max() < 1e-4


def test_the_pose_of_a_board_is_found(lens):
    pixels, _, _ = project(POINTS, POSE, lens)
    assert np.abs(board_pose(POINTS, pixels, lens) - POSE).max() < 1e-4
