"""Every op that has a compiled twin, with inputs on which both forms are compared. A new twin gets a row in `TWINS`."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import Delaunay
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.field_limits import STRAIN_MEASURES
from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse
from fingerflow.kernels.tracking_limits import NUMBERS, WARP_GAUGE_PX, Number
from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.contact.contact_threshold import contact_threshold
from fingerflow.ops.contact.illumination_gain import illumination_gain
from fingerflow.ops.contact.otsu import histogram
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.fields.area_medians import area_medians
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.triangle_strain import triangle_strain
from fingerflow.ops.filters.halving import halved_image
from fingerflow.ops.filters.illumination import normalize_illumination
from fingerflow.ops.filters.median import median_filter
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.spline import spline_coefficients
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.search import search_windows
from fingerflow.ops.tracking.track_points import track_points
from fingerflow.ops.tracking.window_correlation import sample_windows
from fingerflow.synthetic import RidgeTexture
from tests.kernels.contact_frames import contact_frames
from tests.kernels.kernel_images import CONTENTS, SHAPES, images

#: An op with its settings, and its tensors.
Call = tuple[Callable[..., Any], tuple[Any, ...]]
Tolerance = tuple[float, float]  # relative, absolute


class Twin(NamedTuple):
    """An op with a compiled twin.

    Attributes:
        calls: yields the calls that are compared; the last has work for several threads.
        tolerance: of floating-point results; bit for bit by default.
        by_name: tolerances of single fields of the result.
        in_double: whether the portable form computes in float64 from the same numbers, because sums round in both
            forms.
    """

    calls: Callable[[], Iterator[Call]]
    tolerance: Tolerance = (0.0, 0.0)
    by_name: Mapping[str, Tolerance] = MappingProxyType({})
    in_double: bool = False


def random(*shape: int, seed: int = 1) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).float()


def sparse(shape: tuple[int, int, int], share: float) -> Tensor:
    """Return a mask (B, 1, H, W) with this share of single pixels."""
    return images(shape, torch.uint8, "random", highest=249) < 250 * share


def blobs(shape: tuple[int, int, int], share: float) -> Tensor:
    """Return a mask (B, 1, H, W) with this share of patches of about 4 px."""
    batch, height, width = shape
    coarse = sparse((batch, height // 4 + 2, width // 4 + 2), share)
    return coarse.repeat_interleave(4, 2).repeat_interleave(4, 3)[..., 1 : 1 + height, 2 : 2 + width]


def lit(shape: tuple[int, int, int], batch: int) -> tuple[Tensor, Tensor]:
    """Return light and black (batch, 1, H, W); some pixels have no light."""
    light, black = (images((batch, *shape[1:]), torch.float32, "random", seed=seed) for seed in (1, 2))
    return (0.9 * light - 20).clamp(min=0), 0.04 * black


def medians() -> Iterator[Call]:
    for dtype, size, content in product(kernels.COUNTED_DTYPES, (3, 5, 9), CONTENTS):
        for shape in (*SHAPES, (5, 61, 94)):
            yield partial(median_filter, size=size), (images(shape, dtype, content),)


ODD = torch.tensor([torch.nan, torch.inf, -torch.inf, 0.0, -3.0, 3e38, 1e-42])


def quotients() -> Iterator[Call]:
    """Yield calls with frames of every kind, one reference for all or one for each, and some values that are NaN or
    infinite.
    """

    def image(kind: torch.dtype, *shape: int, seed: int) -> Tensor:
        values = 250 * random(*shape, seed=seed)
        if not kind.is_floating_point:
            return values.to(torch.int32).to(kind)
        odd = random(*shape, seed=seed + 1) < 0.05
        values[odd] = ODD.repeat(int(odd.sum()))[: int(odd.sum())]
        return values

    for kind, (batch, lights, *size) in product(
        kernels.FRAME_KINDS, ((1, 1, 1, 1), (0, 1, 4, 4), (3, 3, 40, 5), (3, 1, 97, 133))
    ):
        frames = image(kind, batch, 1, *size, seed=0)
        reference, black = (image(torch.float32, lights, 1, *size, seed=seed) for seed in (2, 4))
        for dark in (None, black / 50, black[:1] / 50):
            yield normalize_illumination, (frames, reference, dark)


RANGES: dict[torch.dtype, list[tuple[int, tuple[float, float] | None]]] = {
    torch.uint8: [(256, None), (256, (-1.0, 255.0)), (256, (9.0, 265.0)), (16, (0.0, 255.0)), (100, (10.5, 200.0))],
    torch.uint16: [(65536, (-1.0, 65535.0)), (4096, (-1.0, 4095.0)), (256, (-1.0, 4095.0)), (50, (100.5, 60000.0))],
}


def histograms() -> Iterator[Call]:
    for dtype, shape in product(RANGES, SHAPES):
        frames, mask = images(shape, dtype, "random"), sparse(shape, 0.6)
        for (bins, value_range), some in product(RANGES[dtype], (None, mask, mask[:1])):
            yield partial(histogram, bins=bins, value_range=value_range), (frames, some)


def regions() -> Iterator[Call]:
    """Yield calls with patches, and with ridges within an ellipse, with a hole and dirt, on frames that are no whole
    number of cells.

    No pixel lies so near the limit that rounding decides on its side; a share of 0.4 would have two.
    """
    settings = ((1, None), (2, None), (8, None), (8, 8), (30, 4), (255, 4))
    for share, shape, (radius, cell) in product((0.0, 0.1, 0.45, 0.7, 1.0), SHAPES, settings):
        yield partial(apparent_contact, radius=radius, cell=cell), (blobs(shape, share),)
    y, x = torch.meshgrid(torch.arange(301.0), torch.arange(403.0), indexing="ij")
    inside = torch.hypot((x - 200) / 150, (y - 140) / 110) < 1
    mask = (inside & (torch.sin(0.45 * (x + 0.3 * y)) > 0))[None, None].repeat(3, 1, 1, 1)
    mask[1, :, 120:170, 190:240] = False
    mask[2, :, 5:30, 360:400] = True
    small = mask & (torch.hypot(x - 290, y - 80) < 30)  # in a part of the view
    for (radius, cell), seen in product(((8, None), (8, 8), (5, None)), (mask, small)):
        yield partial(apparent_contact, radius=radius, cell=cell), (seen,)
    yield partial(apparent_contact, radius=6), (blobs((5, 300, 220), 0.5),)


def contact_masks() -> Iterator[Call]:
    for dtype, content, shape in product(kernels.FRAME_KINDS, CONTENTS, (*SHAPES, (5, 210, 90))):
        frames = images(shape, dtype, content, highest=250)
        limits = torch.linspace(0.3, 0.8, len(frames))
        for batch, size in product({1, len(frames)}, (1, 3, 5, 9, 15)):
            yield partial(real_contact_mask, median_px=size), (frames, *lit(shape, batch), limits)


def gains() -> Iterator[Call]:
    for dtype, shape, radius in product(kernels.FRAME_KINDS, ((1, 66, 129), (3, 256, 320)), (2, 8, 20)):
        light, black = lit(shape, 1)
        light, black = 120 + 0 * light, black + 3
        frames = (0.93 * light + black).repeat(shape[0], 1, 1, 1)
        frames[..., : shape[1] // 2, : shape[2] // 2] *= 0.6
        frames = frames if dtype.is_floating_point else frames.round().to(torch.int32)
        yield partial(illumination_gain, radius=radius), (frames.to(dtype), light, black)


def contact_thresholds() -> Iterator[Call]:
    settings = ((3, 8, 1), (3, 8, 8), (1, 5, 3), (9, 8, 8), (13, 8, 2))
    gain = torch.tensor([1.0, 0.98, torch.nan, 1.04, 1.08])
    for dtype, lights, (median, radius, stride) in product(kernels.FRAME_KINDS, (1, 5), settings):
        op = partial(contact_threshold, median_px=median, radius=radius, stride_px=stride)
        yield op, (*contact_frames(5, 130, 170, dtype, lights), None if lights == 1 else gain)


def thresholds_of_hard_frames() -> Iterator[Call]:
    """Yield calls with frames smaller than windows and cells, an empty glass, one grey level, no light, and no
    frame.
    """
    for shape, (median, stride) in product(SHAPES, ((3, 1), (15, 8), (5, 3))):
        light = torch.full((1, 1, *shape[1:]), 250.0)
        op = partial(contact_threshold, median_px=median, stride_px=stride)
        yield op, (images(shape, torch.uint8, "two levels"), light, 0 * light)
    frames, light, black = contact_frames(2, 64, 80, torch.uint8)
    for some, lamp in ((frames[:0], light), (frames * 0 + 90, light), (frames, 0 * light), (frames[:1], light)):
        yield contact_threshold, (some, lamp, black)
    yield contact_threshold, contact_frames(5, 130, 170, torch.uint8)


def whole_frames(op: Callable[[Tensor], Tensor]) -> Iterator[Call]:
    """Yield calls with frames of every kind, some so high that their rows are sampled, and some pixels NaN or
    infinite.
    """
    shapes = ((1, 3, 3), (2, 3, 64), (1, 64, 3), (3, 33, 35), (0, 8, 8), (1, 200, 130), (2, 300, 400))
    for dtype, shape in product((torch.uint8, torch.uint16, torch.int32, torch.float32), shapes):
        yield op, (images(shape, dtype, "random"),)
    spoilt = images((2, 300, 400), torch.float32, "random")
    spoilt[0, 0, 10, 20], spoilt[0, 0, 30, 5], spoilt[1, 0, :9] = torch.nan, -torch.inf, torch.nan
    yield op, (spoilt,)


def deformed_windows() -> Iterator[Call]:
    """Yield calls with windows all over two frames of waves and outside, one of them at NaN and two at the border."""
    y, x = torch.meshgrid(torch.arange(90.0), torch.arange(120.0), indexing="ij")
    wave = 120 + 60 * torch.sin(0.5 * x + 0.2 * y) + 40 * torch.cos(0.3 * y - 0.1 * x)
    places = random(60, 2) * torch.tensor([119.0, 89.0])
    warp = torch.eye(2) + 0.3 * (random(60, 2, 2, seed=2) - 0.5)
    places[:3], warp[1:3] = torch.tensor([[torch.nan, 13.0], [13.0, 13.0], [106.0, 76.0]]), torch.eye(2)
    for dtype, step in product((torch.uint8, torch.uint16, torch.float32), (3, 5)):
        frames = torch.stack((wave, wave.flip(1)))[:, None].round().to(dtype)
        yield partial(sample_windows, window=25, step=step), (frames, torch.arange(60) % 2, places, warp)


def skin(
    shift: tuple[float, float],
    seed: int = 0,
    size: tuple[int, int] = (151, 190),
    *,
    noise: float = 1.0,
    deformation: Tensor | None = None,
) -> Tensor:
    """Return ridges moved by a shift, with noise, as float32 (1, 1, H, W); `deformation`, about the middle, maps the
    picture to undeformed ridges.
    """
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in size), indexing="ij")
    if deformation is not None:
        middle = torch.tensor([size[1] / 2, size[0] / 2])
        x, y = ((torch.stack((x, y), -1) - middle) @ deformation.double().T + middle).unbind(-1)
    light = RidgeTexture()((x - shift[0]) * 0.0325, (y - shift[1]) * 0.0325)
    grain = noise * torch.randn(size, generator=torch.Generator().manual_seed(seed))
    return (110 + 80 * light + grain).float()[None, None]


def skin_of_bytes(shift: tuple[float, float], seed: int = 0, deformation: Tensor | None = None) -> Tensor:
    """Return `skin` of 150 x 190 px with noise of 2 grey levels, as uint8."""
    return skin(shift, seed, (150, 190), noise=2.0, deformation=deformation).round().clamp(0, 255).to(torch.uint8)


def points_inside(batch: int = 1, count: int = 60) -> Tensor:
    """Return points (batch, count, 2) between pixels, 30 px or more from the border of `skin_of_bytes`."""
    return 30 + random(batch, count, 2, seed=3) * torch.tensor([130.0, 90.0])


def places_in_skin(count: int = 40) -> Tensor:
    """Return points (count, 2) all over the frame, some with templates that reach over its border."""
    return random(count, 2, seed=3) * torch.tensor([189.0, 150.0])


def searched_images() -> tuple[Tensor, Tensor]:
    """Return two images (2, 1, H, W) of skin, before and after it has moved."""
    return torch.cat([skin((0, 0), 0), skin((0, 0), 2)]), torch.cat([skin((4.3, -5.2), 1), skin((1.0, 3.0), 3)])


def searches() -> Iterator[Call]:
    images = searched_images()
    start, guess = places_in_skin(), places_in_skin() + 0.3
    guess[:3] = torch.tensor([[torch.nan, 1.0], [1.0, torch.inf], [1.0, torch.nan]])
    blank = torch.full_like(images[0], 7.0)
    for window, radius in ((21, 6), (9, 1), (15, 24), (33, 13)):
        op = partial(search_windows, window=window, radius=radius)
        yield op, (blank, blank, torch.arange(40) % 2, start, guess)
        yield op, (*images, torch.zeros(0, dtype=torch.int64), start[:0], guess[:0])
        yield op, (*images, torch.arange(40) % 2, start, guess)


WARPS = (
    [[1.0, 0.0], [0.066, 1.0]],  # a vector of samples needs taps of five or six rows
    [[1.0, 0.0], [0.07, 1.0]],
    [[1.0, 0.01], [-0.066, 1.0]],
    [[1.6, 0.0], [0.0, 0.7]],
    [[0.6, 0.2], [0.1, 1.5]],
    [[-1.0, 0.05], [0.02, 1.0]],  # mirrored
    [[0.0, -1.0], [1.0, 0.0]],  # a quarter turn
    [[0.0, 0.0], [0.0, 0.0]],  # zero
    [[1.0, 1.0], [1.0, 1.0]],
    [[torch.nan, 0.0], [0.0, 1.0]],
)
FAR_OFF = [[torch.nan, 5.0], [torch.inf, 5.0], [-300.0, 20.0], [1e9, 1e9], [-3e38, 3e38], [3.0, 3.0], [188.0, 148.0]]


def predicted(*given: Any, **settings: Any) -> Any:
    """Return `track_points` of the tensors, the last two of which are predictions and deformations."""
    *frames_and_points, initial, warp = given
    return track_points(*frames_and_points, initial=initial, warp=warp, **settings)


def tracks() -> Iterator[Call]:
    """Yield calls with any window, motion, deformation, contrast and kind of frames, with NaN pixels, and with points
    outside the frame.
    """
    first, second, points = skin_of_bytes((0, 0)), skin_of_bytes((0.6, -0.3), 1), points_inside()
    for window, free in product((5, 15, 17, 21, 31, 33, 47), (False, True)):
        yield partial(track_points, window=window, gain_offset=free), (first, second, points)
    for motion, start in product(((0.0, 0.0), (0.95, 0.95), (2.5, -1.8), (4.4, -1.2)), (points, points.round())):
        yield track_points, (first, skin_of_bytes(motion, 1), start)
    for dtype in (torch.float64, torch.int32, torch.uint16, torch.float32):
        yield track_points, (first.to(dtype), second.to(dtype), points)
    near = torch.tensor([[[0.3, -0.2], [9.0, 4.5], [-8.2, 6.0], [3.4, -10.0], [-90.0, -70.0]]])
    middle, still = torch.tensor([95.0, 75.0]), skin_of_bytes((0, 0), 1)
    for matrix, window in product(map(torch.tensor, WARPS), (9, 21)):
        guess = middle + near @ matrix.T + torch.tensor([0.2, -0.2])
        given = skin_of_bytes((0, 0), deformation=matrix.nan_to_num()), still, middle + near
        yield partial(predicted, window=window), (*given, guess, matrix.expand(1, 5, 2, 2))
    leaning = torch.tensor([[1.05, 0.02], [-0.03, 0.97]]).expand(1, 60, 2, 2)
    for far in (0.0, 0.7):
        guess = points + torch.tensor([0.6 + far, -0.3])
        yield partial(predicted, mismatch_limit=0.5), (first, second, points, guess, leaning)
    # Steps by the structure tensor of the template are too long by 1 / gain; Newton's steps are not.
    for gain, warp in product((0.45, 2.1), (None, torch.eye(2).expand(1, 60, 2, 2))):
        yield predicted, (first.float(), gain * skin_of_bytes((0.3, -0.2), 1).float(), points, None, warp)
    # The backward check of a searched point begins where its search ended.
    for warp in (None, torch.tensor([[1.01, 0.01], [-0.01, 0.99]]).expand(1, 60, 2, 2)):
        yield partial(predicted, search=12), (first, skin_of_bytes((9.3, -6.6), 1), points, None, warp)
    nowhere = torch.tensor([FAR_OFF])
    yield track_points, (first, second, nowhere)
    guess = points[:, :7] + nowhere.nan_to_num(0.0, 1e30, -1e30)
    yield predicted, (first, second, points[:, :7], guess, None)
    one, other = first.float(), second.float()
    one[..., 60, 70], other[..., 100, 120] = torch.nan, torch.inf
    yield track_points, (one, other, points)
    frames = [torch.cat([skin_of_bytes((0.2 * k * far, 0.1 * far), k) for k in range(3)]) for far in (0, 1)]
    yield track_points, (*frames, points_inside(3))


def corrections() -> Iterator[Call]:
    """Yield calls with a press with noise, some points of which are lost and one has no position."""
    for count, frames in ((700, 1), (40, 3), (17, 2), (4, 2), (1, 1), (0, 2), (9, 0), (300, 4)):
        random = np.random.default_rng(0)
        start = random.uniform((40, 40), (500, 440), (1, count, 2))
        from_middle = start - 250.0
        moved = from_middle @ np.array([[0.02, 0.004], [-0.006, -0.015]]).T + 2e-5 * from_middle**2
        points = start + moved + random.normal(0, 0.02, (frames, count, 2))
        covariance = random.uniform(1e-4, 1e-3, (frames, count, 1, 1)) * np.eye(2)
        lost = random.uniform(size=(frames, count)) < 0.1
        points[lost], covariance[lost] = np.nan, np.nan
        numbers = random.normal(0, 1, (1, count, NUMBERS))
        numbers[..., Number.NOISE] = random.uniform(0.5, 2, count)
        numbers[..., Number.COVARIANCE_XX : Number.COVARIANCE_YY + 1] = (1e-4, 0, 1e-4)
        numbers[..., Number.BENDING :] = random.uniform(0, 2e4, (count, 10))
        inverse = np.eye(2) + random.normal(0, 0.01, (1, count, 2, 2))
        if count > 5:
            start[0, 2], numbers[0, 2], points[:1, 3], covariance[:1, 4] = np.nan, np.nan, np.inf, 0
        given = (torch.from_numpy(one).float() for one in (start, points, covariance, numbers, inverse))
        yield partial(correct_points, window=25, gauge_px=WARP_GAUGE_PX), tuple(given)


def local_fits(dtype: torch.dtype, gauge: float, unit: float) -> Iterator[Call]:
    """Yield calls with one geometry for all frames and with one for each; some points, values and queries are NaN or
    far away.
    """

    def fit(points: Tensor, values: Tensor, queries: Tensor, variance: Tensor | None) -> Any:
        return local_gradients(points * unit, values, queries * unit, gauge_length=gauge * unit, variance=variance)

    for batches, components, noise in (
        ((1, 1, 1), 2, "shared"),
        ((1, 3, 1), 1, None),
        ((1, 3, 1), 2, "full"),
        ((3, 3, 3), 5, "shared"),
        ((3, 1, 1), 2, "full"),
        ((1, 1, 3), 3, None),
        ((0, 0, 0), 2, "shared"),
        ((1, 0, 1), 2, None),
    ):
        points, queries = (
            10 * random(batches[0], 301, 2).to(dtype),
            12 * random(batches[2], 83, 2, seed=3).to(dtype) - 1,
        )
        values = 100 + random(batches[1], 301, components, seed=2).to(dtype)
        root = random(batches[1], 301, components, components, seed=4).to(dtype)
        variance = {None: None, "shared": root[..., 0, 0], "full": root @ root.mT}[noise]
        yield fit, (points, values, queries, variance)
    for few, asked in ((0, 5), (5, 0), (1, 1), (17, 33)):
        values = random(1, few, 2).to(dtype)
        yield fit, (values, values, random(1, asked, 2, seed=3).to(dtype), values[..., 0])
    points, values = 10 * random(1, 300, 2).to(dtype), random(3, 300, 2, seed=2).to(dtype)
    if dtype == torch.float64:
        away, asked = points.clone(), 10 * random(1, 300, 2, seed=3).to(dtype)
        away[0, :2], away[0, 2:6], asked[0, :5], asked[0, 5] = 1e6, -1e5, 1e6 + 0.5, -1e5
        yield fit, (away, values, asked, None)
    variance, queries = random(3, 300, seed=3).to(dtype), 10 * random(1, 50, 2, seed=4).to(dtype)
    points[0, 3, 1], points[0, 4, 0], values[1, 10:30, 0], values[2] = torch.nan, torch.inf, torch.nan, torch.nan
    variance[0, 50:60], variance[0, 60:70], variance[1, 70] = -1.0, torch.inf, torch.nan
    queries[0, 5, 0], queries[0, 6, 1] = torch.nan, -torch.inf
    yield fit, (points, values, queries, variance)


def area_fields(with_others: bool) -> Iterator[Call]:
    """Yield calls with rough displacements and ellipses of all sizes in the cloud of points, over its border and
    outside.

    If `with_others`, a third of the points have fields of their own, some of them NaN.
    """
    sizes = ((0, 0.0, True), (50, 0.0, False), (700, 0.3, True), (700, 0.0, True), (700, 0.0, False))
    for measure, (points, unknown, noisy) in product(STRAIN_MEASURES, sizes[2:] if with_others else sizes):
        reference = 12 * random(1, points, 2) + 50
        displacement = 0.3 * random(9, points, 2, seed=2) + 0.05 * (reference - 50)
        displacement[random(9, points, seed=3) < unknown] = torch.nan
        root = 0.01 * random(9, points, 2, 2, seed=4)
        center, axes = 56.5 + 3 * random(9, 2, seed=5), 0.02 + 5 * random(9, 2, seed=6) ** 2
        center[0], axes[1, 0], axes[2] = 1000.0, 0.0, 100.0
        entered: tuple[Any, ...] = ()
        if with_others:
            gradient, spread = random(9, points, 2, 2, seed=8) - 0.5, 0.01 * random(9, points, 4, 4, seed=10)
            gradient[random(9, points, seed=9) < 0.2] = torch.nan
            variances = (spread @ spread.mT).unflatten(3, (2, 2)).unflatten(2, (2, 2)) if noisy else None
            entered = (reference[..., 0] < 54).expand(9, -1), gradient, variances
        given = reference, displacement, center, axes, 6 * random(9, seed=7), root @ root.mT if noisy else None
        yield partial(_area_medians, measure), (*given, *entered)


def _area_medians(measure: str, *given: Any) -> Any:
    reference, displacement, *ellipse, covariance = given[:6]
    entered = EnteredPoints(*given[6:]) if given[6:] else None
    settings = {"gauge_length": 2.0, "measure": measure, "covariance": covariance, "entered": entered}
    return area_medians(reference, displacement, FrameEllipse(*ellipse), **settings)


def strains_of_triangles() -> Iterator[Call]:
    solid = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.45}
    for measure, (points, unknown) in product(STRAIN_MEASURES, ((3, 0.0), (700, 0.6), (701, 0.1), (700, 0.0))):
        reference, displacement = 12 * random(1, points, 2), 0.05 * random(9, points, 2, seed=2)
        displacement[random(9, points, seed=3) < unknown] = torch.nan
        root = 0.01 * random(9, points, 2, 2, seed=4)
        covariance = (root @ root.mT).masked_fill(displacement.isnan().any(-1)[..., None, None], torch.nan)
        triangles = torch.from_numpy(Delaunay(reference[0].numpy()).simplices).long()
        in_contact = random(9, len(triangles), seed=5) < 0.7
        in_contact[0] = False
        pairs = (points * random(50, 2, seed=7)).long()
        shared = 0.9 * random(len(triangles), 3, seed=6), pairs, 0.9 * random(50, seed=8)
        given = reference, triangles, displacement, covariance, in_contact
        yield partial(triangle_strain, measure=measure, **solid), (*given, None if unknown else shared)


def of_fits(dtype: torch.dtype, radius: float) -> dict[str, Tolerance]:
    """Return tolerances of a hundred roundings of sums of up to 300 products, times the worst ratio of radius to
    spread, squared.
    """
    rounding = 100 / 0.1**2 * torch.finfo(dtype).eps
    sizes = {"value": 1.0, "gradient": 1 / radius, "centroid_offset": radius, "covariance": 1 / radius**2}
    return {name: (rounding, rounding * size) for name, size in sizes.items()}


#: Tolerances of regions: if rounding changes the density of a cell at the border, some pixels change sides.
REGION = {"density_margin": (2e-5, 2e-5), "angle": (2e-5, 1e-2)}
#: Tolerances of areas: one position of 800, at a limit, may count in one form only.
AREA = {"known": (0.0, 3 / 800), "std": (2e-2, 1e-6)}
TWINS = {
    "median_filter": Twin(medians),
    "normalize_illumination": Twin(quotients),
    "histogram": Twin(histograms),
    "apparent_contact": Twin(regions, (2e-5, 5e-3), REGION),  # px: an axis of 12 px where ridges cover a tenth
    "real_contact_mask": Twin(contact_masks),
    "illumination_gain": Twin(gains, (1e-5, 0.0)),
    "contact_threshold": Twin(contact_thresholds, (0.0, 1e-4)),
    "contact_threshold of hard frames": Twin(thresholds_of_hard_frames, (0.0, 1e-2)),
    "halved_image": Twin(partial(whole_frames, halved_image)),
    "spline_coefficients": Twin(partial(whole_frames, spline_coefficients)),
    "estimate_noise": Twin(partial(whole_frames, estimate_noise), (1e-5, 1e-7)),
    # Positions are rounded to 1e-5 px, on slopes of 50 grey levels per px.
    "sample_windows": Twin(deformed_windows, (0.0, 2e-3), in_double=True),
    "search_windows": Twin(searches, (0.0, 1e-2)),  # px: a start for the tracker
    # Float32 positions of a few hundred px have steps of 3e-5 px. The residual is a difference of sums of squares a
    # hundred times as large, so that float32 leaves some percent.
    "track_points": Twin(tracks, (0.0, 1e-4), {"covariance": (2e-2, 2e-6)}),
    # Positions agree to two units in the last place. Portable fits are matrix products, whose gradients differ by a few
    # 1e-5 where points are few, and by a third more where they are extrapolated, or squared in the covariance.
    "correct_points": Twin(
        corrections, (1e-5, 1.3e-4), {"covariance": (1e-5, 1e-6), "warp": (1e-5, 4e-5), "shift": (1e-5, 6e-4)}
    ),
    **{
        f"local_gradients {dtype} {gauge * unit}": Twin(
            partial(local_fits, dtype, gauge, unit), by_name=of_fits(dtype, gauge * unit / 2), in_double=True
        )
        for dtype, gauge, unit in product((torch.float32, torch.float64), (2.5, 40.0), (1e-6, 1.0, 1e6))
    },
    "area_medians": Twin(partial(area_fields, False), (1e-4, 1e-4), AREA, in_double=True),
    # A position equally far from two points may have the field of either: one rank of 800.
    "area_medians of points apart": Twin(partial(area_fields, True), (0.0, 1e-3), AREA, in_double=True),
    "triangle_strain": Twin(
        strains_of_triangles, (1e-5, 1e-5), {"energy": (1e-5, 0.0), "energy_std": (1e-5, 0.0)}, in_double=True
    ),
}
