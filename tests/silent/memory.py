"""Cases of hostile calls of kernels, and of inputs for which compiled and portable implementations once differed."""

from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact_frames import contact_of_frames
from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.contact.illumination_gain import illumination_gain
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.tracking.search import search_windows
from fingerflow.schema.scene_tables import SCENE
from tests.kernels import hostile_calls
from tests.silent.case import Case


def cases() -> Iterator[Case]:
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    yield from _hostile()
    yield from _both_forms()
    yield from _others()


def _hostile() -> Iterator[Case]:
    """Yield a case for each function of the kernels: the outcomes of its hostile calls."""
    for name, call in hostile_calls.plain_calls().items():
        every = list(hostile_calls.hostile_calls({name: call}))
        words = Counter(word for _, word, _ in hostile_calls.outcomes(every, call))
        right = words[hostile_calls.REFUSED] + words[hostile_calls.GIVEN] == len(every)
        counts = ", ".join(f"{count} {word}" for word, count in sorted(words.items()))
        yield Case(f"{len(every)} hostile calls of {name}", counts, "refused or right", "an error", _verdict(right))


def _both_forms() -> Iterator[Case]:
    image, light = 100 * _random(1, 1, 40, 50), torch.full((1, 1, 15, 40), 105.0)
    far, index = torch.tensor([[1e30, -300.0]]), torch.zeros(1, dtype=torch.int64)
    middle = torch.tensor([[25.0, 20.0]])
    unknown, black = torch.full((1,), torch.nan), torch.full((1, 1, 15, 40), 12.0)
    dark = torch.full((1, 1, 15, 40), 8, dtype=torch.uint8)
    reference, displacement = 10 * _random(1, 40, 2), _random(1, 40, 2)
    covariance = torch.eye(2).repeat(1, 40, 1, 1)
    covariance[0, 3] = torch.nan
    full = torch.ones(1, 1, 600, 300, dtype=torch.bool)
    forms: dict[str, tuple[Callable[[], Tensor], float]] = {
        "window searched outside the image, x": (
            lambda: search_windows(image, image.flip(3), index, far, middle, 21, 24)[0, 0],
            25.0,
        ),
        "illumination gain of 15 x 40 px": (lambda: illumination_gain(0.97 * light, light, 0 * light)[0], 0.97),
        "pixels of a full mask on cells of 400 px": (lambda: apparent_contact(full, 255, 400).covered_px[0], 180000.0),
        "contact of black pixels without a threshold, px": (
            lambda: real_contact_mask(dark, light, black, unknown).sum(),
            0.0,
        ),
        "gradient of a point without a covariance": (
            lambda: point_gradients(reference, displacement, 8.0, covariance)[0][0, 3, 0, 0],
            float("nan"),
        ),
    }
    for name, (form, truth) in forms.items():
        found = float(form()), float(_portable(form))
        right = np.allclose(found, truth, rtol=1e-5, equal_nan=True)
        yield Case(name, f"compiled {found[0]:g}, portable {found[1]:g}", f"{truth:g}", "", _verdict(right))
    touching = contact_of_frames(
        *(one.numpy() for one in (dark, light, black, unknown)), median_px=3, radius=8, cell=4
    ).real_contact_mask.sum()
    yield Case("the same of the native engine, px", f"{touching}", "0", "", _verdict(touching == 0))


def _others() -> Iterator[Case]:
    most = SCENE["contact"].keys["median_px"].type.most  # type: ignore[attr-defined]
    yield Case("contact.median_px of 17 in a scene", "none", "refused", f"1 to {most} px", _verdict(most == 15))


def _portable(form: Callable[[], Tensor]) -> Tensor:
    serve = kernels.serve
    kernels.serve = lambda *tensors: False  # type: ignore[assignment]
    try:
        return form()
    finally:
        kernels.serve = serve  # type: ignore[assignment]


def _random(*shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1))


def _verdict(right: bool) -> str:
    return "right" if right else "wrong in silence"
