"""
Does it work inside a kornia pipeline?
======================================

Ops and modules take kornia's images `(B, 1, H, W)` and points `(B, N, 2)` as (x, y) px, with whole numbers at pixel
centres. So the modules of `fingerflow.graphs` are steps of kornia's containers, and an augmentation of kornia moves
frames and points alike. Here camera counts of a simulated press become training data: normalised, filtered, augmented.
"""

import matplotlib.pyplot as plt
import torch
from kornia.augmentation import AugmentationSequential, RandomAffine, RandomGaussianNoise
from kornia.augmentation.container import ImageSequential

from fingerflow import ops
from fingerflow.graphs import MedianFilter, NormalizeIllumination
from fingerflow.synthetic import Press

torch.manual_seed(0)
press = Press(n_frames=24, frame_rate=24.0, frame_shape=(192, 480), finger=(2.9, 2.4), semi_axes=(2.1, 1.7))


def view(name: str, picture: object) -> torch.Tensor:
    """Return a view of a picture of the camera as a tensor (1, 1, H, W) of counts."""
    return torch.from_numpy(press.views[name].crop(picture)).float()[None, None]


# %%
# The contact view in kornia's `ImageSequential`: light relative to the empty glass, then medians. Skin touches where a
# quarter of the light is lost; the area is compared with the truth.

last = press.render(press.n_frames - 1)
empty, dark = press.empty(), press.dark()
clean = ImageSequential(
    NormalizeIllumination(view("contact", empty), view("contact", dark)),
    MedianFilter(3),
)
light = clean(view("contact", last))
area = float((light < 0.75).sum()) * press.mm_per_px**2
true = press.truth.real_contact_area_mm2(press.n_frames - 1)
print(f"real contact area {area:.2f} mm², truth {true:.2f} mm²")
assert abs(area / true - 1) < 0.05

# %%
# The topography view in `AugmentationSequential` with keypoints: our median, against defective pixels, stands before
# kornia's augmentations, which move, with the frame, the corners found in it. The tracker finds the corners where the
# augmentation puts them.

counts = view("topography", last) / 255
before = MedianFilter(3)(counts)
points = ops.detect_corners(255 * before, count=60, min_distance=8, border=40).points
augment = AugmentationSequential(
    ImageSequential(MedianFilter(3)),
    RandomAffine(degrees=3.0, translate=(0.02, 0.02), p=1.0),
    RandomGaussianNoise(std=0.01, p=1.0),
    data_keys=["input", "keypoints"],
)
moved, expected = augment(counts, points)
tracks = ops.track_points(255 * before, 255 * moved, points, window=21)
found = tracks.status == 0
error = (tracks.points - expected).norm(dim=-1)[found]
print(f"{int(found.sum())} of {found.numel()} points found, median error {error.median():.3f} px")
assert found.float().mean() > 0.8
assert error.median() < 0.1

_, axes = plt.subplots(1, 3, figsize=(9, 2.9), layout="constrained")
titles = "contact view, light", "topography view, corners", "augmented, tracked"
for panel, image, at, title in zip(axes, (light, before, moved), (None, points, tracks.points), titles, strict=True):
    panel.imshow(image[0, 0], cmap="gray", vmin=0, vmax=image.quantile(0.99))
    if at is not None:
        panel.plot(*at[0][found[0]].T, ".", color="tab:orange")
    panel.set_title(title, fontsize=9)
    panel.axis("off")
