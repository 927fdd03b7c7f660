"""The tracker of a stream beside `ops.track_points`, and its constants beside the splines they come from."""

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.ops.corners import detect_corners
from fingerflow.ops.spline import spline_basis, spline_basis_derivative
from fingerflow.ops.tracking import TrackStatus, track_points
from fingerflow.stream.detect import DetectStep
from fingerflow.stream.key import KeyStep
from fingerflow.stream.spline_features import SCALE, feature_bends, features, features_and_slopes
from fingerflow.stream.track import TrackStep, WayBack
from fingerflow.synthetic import Press

SCENE = Press()


def _view(frame: int) -> Tensor:
    picture = SCENE.views["topography"].crop(SCENE.render(frame))
    return torch.from_numpy(np.ascontiguousarray(picture))[None, None]


def _places(side: int) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64),) * 2, indexing="ij")
    return y, x


def _texture(x: Tensor, y: Tensor) -> Tensor:
    """(1, 1, H, W) grey levels."""
    waves = torch.sin(x / 1.9 + torch.sin(y / 7)) + torch.sin(y / 2.3 + torch.sin(x / 5)) + torch.sin((x + y) / 3.1)
    return (128 + 30 * waves)[None, None].float()


@pytest.fixture(scope="module")
def views() -> tuple[Tensor, Tensor]:
    return _view(200), _view(203)


@pytest.fixture(scope="module")
def points(views: tuple[Tensor, Tensor]) -> Tensor:
    return detect_corners(views[0], 200, 6.0, window=5, border=18).points


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_features_are_the_spline(reach: int) -> None:
    shift = torch.linspace(-reach, reach, 401, dtype=torch.float64)
    place = torch.arange(-reach - 1, reach + 2, dtype=torch.float64)[:, None]
    values, slopes = (one[0, :, 0] / SCALE for one in features_and_slopes(shift[None, None], reach))
    torch.testing.assert_close(values, spline_basis(shift - place, 3), rtol=0, atol=1e-13)
    torch.testing.assert_close(values, features(shift[None, None], reach)[0, :, 0] / SCALE, rtol=0, atol=0)
    torch.testing.assert_close(slopes, spline_basis_derivative(shift - place, 3), rtol=0, atol=1e-13)
    step = 1e-6  # third derivatives jump at the knots: by 6 at most
    after, before = (features_and_slopes(shift[None, None] + by, reach)[1] for by in (step, -step))
    bends = feature_bends(shift[None, None], reach)
    torch.testing.assert_close(bends, (after - before) / (2 * step), rtol=0, atol=SCALE * 3 * step)


@pytest.mark.parametrize(("window", "reach"), [(15, 1), (21, 1), (21, 2)])
@pytest.mark.parametrize("way_back", ["table", "step"])
def test_tracks_are_those_of_track_points(
    window: int,
    reach: int,
    way_back: WayBack,
    views: tuple[Tensor, Tensor],
    points: Tensor,
) -> None:
    expected = track_points(*views, points, window, passes=1, gain_offset=False)
    templates = KeyStep(window, reach)(views[0], points)
    tracks = TrackStep(window, reach, way_back)(views[1], points, templates)
    assert torch.equal(tracks.status, expected.status)
    # Rounding of positions of some hundred px in float32 is 3e-5 px; the key frame's slopes, in place of the frame's,
    # leave a tenth of the last step.
    exact = 1e-4 if way_back == "table" else 1e-3
    torch.testing.assert_close(tracks.points, expected.points, rtol=0, atol=exact, equal_nan=True)
    torch.testing.assert_close(tracks.error, expected.error, rtol=0, atol=max(exact, 2e-4), equal_nan=True)


@pytest.mark.parametrize("window", [11, 21])
@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_edges_of_a_window_tell_the_size_of_the_error(
    window: int, noise: float, views: tuple[Tensor, Tensor], points: Tensor
) -> None:
    """Points and states are those of the way back by a step. Errors are up to a fourth smaller, and go with its errors:
    0.73 to 1.01 and correlations of 0.60 to 0.75 were seen. With the axes exchanged the latter are 0.20 to 0.49, and
    with sums in place of differences errors are 2 to 4 times too large."""
    generator = torch.Generator().manual_seed(5)
    noisy = views[1] + noise * torch.randn(views[1].shape, generator=generator)
    templates = KeyStep(window)(views[0], points)
    step, edges = (TrackStep(window, 1, one)(noisy, points, templates) for one in ("step", "edges"))
    torch.testing.assert_close(edges.points, step.points, rtol=0, atol=2e-4, equal_nan=True)
    torch.testing.assert_close(edges.covariance, step.covariance, rtol=1e-4, atol=1e-9, equal_nan=True)
    assert torch.equal(edges.status, step.status)
    pair = torch.stack((edges.error, step.error)).flatten(1)
    pair = pair[:, pair.isfinite().all(0)]
    for share in (0.5, 0.9, 0.99):
        ours, expected = pair.quantile(share, dim=1)
        assert 0.65 < ours / expected < 1.15
    assert pair.corrcoef()[0, 1] > 0.55


def test_edges_of_a_window_are_its_gradient_summed() -> None:
    """A difference that is quadratic: half its square, of which the sum of the slopes between pixels is exact."""
    y, x = _places(9)
    difference = (0.3 * (x - 4) + 0.02 * (x - 4) * (y - 2) - 0.1 * y).flatten()
    square = (difference**2).reshape(9, 9) / 2
    between = torch.stack((square.diff(dim=1).sum(), square.diff(dim=0).sum()))
    torch.testing.assert_close(difference**2 @ TrackStep(9, precision=torch.float64).edges, between)


@pytest.mark.parametrize("shift", [0.3, 0.6])
@pytest.mark.parametrize("strain", [0.0, 0.1])
def test_points_are_found_away_from_their_prediction(shift: float, strain: float) -> None:
    y, x = _places(160)
    points = 25 + 110 * torch.rand(30, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    key, step = KeyStep(21), TrackStep(21)
    before = _texture(x, y)
    for point in points:
        moved = point + shift * torch.tensor([0.8, -0.6])
        # Stretched along x about the point.
        after = _texture(point[0] + (x - moved[0]) / (1 + strain), point[1] + (y - moved[1]))
        one = point[None, None].float()
        tracks, expected = (
            step(after, one, key(before, one)),
            track_points(before, after, one, 21, passes=1, gain_offset=False),
        )
        if (moved - point.round()).abs().amax() < 0.75:
            assert tracks.status.item() == 0
            torch.testing.assert_close(tracks.points, expected.points, rtol=0, atol=5e-4)


def test_float64_agrees_to_a_hundred_thousandth(views: tuple[Tensor, Tensor], points: Tensor) -> None:
    near = TrackStep(21)(views[1], points, KeyStep(21)(views[0], points))
    exact = torch.float64
    far = TrackStep(21, precision=exact)(views[1], points, KeyStep(21, precision=exact)(views[0], points))
    torch.testing.assert_close(near.points.double(), far.points, rtol=0, atol=1e-4, equal_nan=True)


def test_what_cannot_be_tracked_has_a_reason(views: tuple[Tensor, Tensor], points: Tensor) -> None:
    some = points[:, :6].clone()
    some[0, 0] = torch.nan
    some[0, 1] = torch.tensor([2.0, 200.0])
    prediction = some.clone()
    prediction[0, 2] = torch.nan
    prediction[0, 3] += 20
    prediction[0, 4, 0] = 1e9
    tracks = TrackStep(21)(views[1], prediction, KeyStep(21)(views[0], some))
    status = [TrackStatus(int(value)) for value in tracks.status[0]]
    assert status[0] == status[2] == TrackStatus.NOT_FINITE
    assert status[1] == TrackStatus.LEFT_FRAME
    assert status[3] in (TrackStatus.NOT_CONVERGED, TrackStatus.MISMATCH, TrackStatus.FORWARD_BACKWARD)
    assert status[4] in (TrackStatus.LEFT_FRAME, TrackStatus.NOT_CONVERGED)
    assert status[5] == TrackStatus.TRACKED
    assert tracks.points[0, :5].isnan().all()
    blank = torch.full_like(views[0], 90)
    nothing = TrackStep(21)(views[1], points, KeyStep(21)(blank, points))
    assert (nothing.status == TrackStatus.NO_TEXTURE).all()


def test_points_at_the_border() -> None:
    """The table of the key frame reaches 14 px from the middle of a window of 21 px."""
    y, x = _places(100)
    view = _texture(x, y)
    edges = torch.tensor([[14.0, 50.0], [85.0, 50.0], [50.0, 14.0], [50.0, 85.0]])
    inwards = torch.tensor([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    for points, status in ((edges, TrackStatus.TRACKED), (edges - 0.1 * inwards, TrackStatus.LEFT_FRAME)):
        tracks = TrackStep(21)(view, points[None], KeyStep(21)(view, points[None]))
        assert (tracks.status == status).all()
    tracks = TrackStep(21)(view, edges[None], KeyStep(21)(view, edges[None]))
    torch.testing.assert_close(tracks.points[0], edges, rtol=0, atol=1e-4)


def test_recordings_side_by_side_do_not_mix(views: tuple[Tensor, Tensor], points: Tensor) -> None:
    both = torch.cat((views[0], views[1])), torch.cat((views[1], views[0])), torch.cat((points, points.flip(1)))
    together = TrackStep(15)(both[1], both[2], KeyStep(15)(both[0], both[2]))
    for number in range(2):
        own = tuple(one[number : number + 1] for one in both)
        alone = TrackStep(15)(own[1], own[2], KeyStep(15)(own[0], own[2]))
        torch.testing.assert_close(together.points[number], alone.points[0], rtol=0, atol=1e-4, equal_nan=True)


def test_corners_are_strong_apart_and_inside(views: tuple[Tensor, Tensor]) -> None:
    mask = torch.ones_like(views[0], dtype=torch.bool)
    mask[..., :100] = False
    points, response = DetectStep(100, 3, 13)(views[0], mask)
    found = points[0][points[0].isfinite().all(-1)]
    assert len(found) == 100
    assert (response[0].diff() <= 0).all()
    height, width = views[0].shape[-2:]
    assert (found[:, 0] >= 100).all()
    assert (found >= 13).all()
    assert (found <= torch.tensor([width - 14, height - 14])).all()
    apart = (found[:, None] - found).abs().amax(-1) + 1e9 * torch.eye(len(found))
    assert apart.min() > 3
    none, _ = DetectStep(20, 3, 13)(torch.full_like(views[0], 80), mask)
    assert none.isnan().all()
