"""Contact in every frame: real and apparent (gross) area, fitted ellipse, and region of the apparent contact."""

from typing import Any, ClassVar

import cv2
import numpy as np
import torch
import xarray as xr

from fingerflow.engines.contact_view import glass_light
from fingerflow.engines.engine import FrameContact, Images
from fingerflow.errors import FingerflowError
from fingerflow.kernels.array_types import Array, Mask, Numbers, Series
from fingerflow.ops.contact.cells import mask_of
from fingerflow.pipeline.stages.contact import view_faults
from fingerflow.pipeline.stages.preparation import plausibility, ridges
from fingerflow.pipeline.stages.preparation.frame_check import FrameCheckStage
from fingerflow.pipeline.stages.preparation.inputs import SCALE_KEYS, read_frames, region_mask
from fingerflow.pipeline.stages.preparation.loading import LoadingStage
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.schema.variables import CONTACT, sparse_border_mm
from fingerflow.tracker import area_steps
from fingerflow.tracker.faint_rim import check_faint_rim, pale_rim
from fingerflow.tracker.sizes_on_glass import SizesOnGlass

_LEAST_LIGHT = 0.1
_LOOKS = 32  # frames sampled to find the one with the largest contact, if forces are unknown
_STEP = 4  # px between sampled pixels
_BRIGHTER = 1.2  # ratio to the light of the empty glass above which a pixel counts as brighter
# Radii of averaging in ridge periods, and the border's errors, mm, on presses of four skins and two sizes: below half a
# period valleys cut in, above one the border loses its curvature.
_AVERAGED = (0.2, 0.45, 1.0, 2.0), (0.15, 0.0, 0.0, 0.05)
_STEADY = 0.01  # change of the illumination gain below which areas do not change


class ContactStage(Stage):
    """Stage that measures real area, gross area, gross region and fitted ellipse of the contact in every frame.

    The stage stores measured quantities, no images.

    Attributes:
        reference_frame: the frame with most contact; `moment` says in words which that is.
        cell_px: side of the cells of the gross region, px of the contact view.
        skin: that touches in the reference frame; None if too little does.
        faint_rim_mm: by which the border may lie further out, as the rim of the contact is pale or thin, or by which
            it is uncertain, as ridges cover little of it; else 0.
    """

    name = "contact"
    gives = CONTACT
    needs = ("views.contact",)
    after: ClassVar[tuple[type[Stage], ...]] = (LoadingStage, FrameCheckStage)
    reads_frames = True
    settings = ("kind", "contact", "views.contact", "background", "recording.first_frame", *SCALE_KEYS)

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        self._view = self.inputs.scene.views.contact
        self._engine = self.inputs.engine
        self.cell_px = self._engine.cell_px
        self._on_glass = SizesOnGlass(self.inputs.geometry, self.cell_px)
        self._gain = np.full(len(trial), np.nan)  # illumination gain
        # Share of the border of the contact at the edge of the view, and real contact area, mm^2, away from the gross
        # contact region.
        self._cut, self._outside = np.zeros((2, len(trial)))
        self.faint_rim_mm = self._pale_rim_mm = 0.0
        self._specks_mm2 = 0.0  # real contact beside the largest gross contact, by impulses and noise
        self._several_parts = False  # whether the view shows a contact beside the gross contact region

    def begin(self) -> None:
        light, level = glass_light(*self.inputs.glass(self._view))
        self._glass, self._black = light[0, 0], level[0, 0]
        # Outside the scene's region the light is set to 0, so that no contact is detected there.
        drawn = region_mask(self.inputs.scene, "contact")
        self._light = light if drawn is None else np.where(drawn, light, np.float32(0)), level
        empty = self._samples(self._glass)
        self._lit = self._samples(self._light[0][0, 0]) > _LEAST_LIGHT * empty.max()
        self._light_of_lit = empty[self._lit]
        first = int(np.argmax(self.usable))
        at_first = self._changed(first)
        background = [*plausibility.check_background(*at_first, first + self.first_frame)]
        self.reference_frame, self.moment = self._most_contact()
        changed, appears = self._changed(self.reference_frame), self.inputs.scene.contact.appears
        contrast = [*plausibility.check_contrast(*changed, appears, self.moment)]
        self.warnings += [*background, *contrast]
        self._threshold = self._fixed_threshold(background if max(at_first) > plausibility.ALL_CHANGED else contrast)
        contact = self._contact(self.reference_frame)
        self._largest = self._gross_region(contact)
        self._second_px = view_faults.SECOND_CONTACT * self._largest.sum()  # least size of a second contact
        skin = self._counts(self.reference_frame)[0] - self._black
        self.skin = ridges.skin_patch(skin, self._glass, self._largest)
        self._period_px = np.nan if self.skin is None else ridges.period_px(self.skin)
        self.warnings += plausibility.check_ridges(self._period_px, self.inputs.mm_per_px)
        self._check_view(contact)
        if "gross_contact_region" in self.trial.requested:
            rows, columns = (-(-side // self.cell_px) for side in self._view.shape)
            self.results.create("gross_contact_region", self.cells(), cell_row=rows, cell_column=columns)

    def step(self, batch: Batch) -> Any:
        """Measure the contact in a batch of frames, store it, and return it as `FrameContact`."""
        contact = self._measure(self._engine.images(self.inputs.counts(batch.frames, self._view)))
        indices, sizes = batch.indices, self._on_glass.sizes(contact)
        for name, values in {"contact_threshold": contact.threshold, **sizes.by_name()}.items():
            self.series[name][indices] = values
        if "gross_contact_region" in self.results:
            region = contact.density_margin[:, 0] > 0
            self.results["gross_contact_region"][indices] = region & self.usable[indices, None, None]
        self._leave_out_parts(contact, indices, np.broadcast_to(sizes.pixel, len(indices)))
        self._cut[indices] = area_steps.cut_shares(contact.density_margin[:, 0], sizes.gross) * self.usable[indices]
        self._gain[indices] = contact.illumination_gain
        return contact

    def finish(self) -> None:
        """Store contact areas and ellipses of all frames; warn if the illumination changed by an unknown factor."""
        if self._several_parts:
            self.series["real_contact_area"] -= self._outside
        for values in (*self.series.values(), self._gain):
            values[~self.usable] = np.nan
        real, gross = self.series["real_contact_area"], self.series["gross_contact_area"]
        blind, gains = np.flatnonzero(np.isnan(self._gain) & (real > 0)), self._gain[np.isfinite(self._gain)]
        if len(blind) and (not len(gains) or np.abs(gains - 1).max() > _STEADY):
            self.warnings.append(
                f"areas in {len(blind)} frames, the first is {blind[0] + self.first_frame}, may be wrong: the finger "
                f"covers the glass that would show how the light has changed. Leave some glass free, or record it again"
            )
        area = self._view.shape[0] * self._view.shape[1] * self.inputs.mm_per_px**2
        self.warnings += plausibility.check_areas(real, gross, self._engine.settings.gross_radius_px, self.first_frame)
        self.warnings += area_steps.check_light_steps(gross, area, self.first_frame)
        normal = self.known("normal_force")
        if self.inputs.scene.kind != "slip" and not self._several_parts:
            self.warnings += area_steps.check_missing_frames(gross, normal, self.first_frame)
        self.warnings += area_steps.check_cut(self._cut.max(), int(self._cut.argmax()) + self.first_frame)
        self.warnings += view_faults.check_strip(self.series["ellipse_semi_axes"], gross, self.first_frame)
        if normal is not None:
            self.warnings += plausibility.check_pressure(normal, gross)
            self.warnings += plausibility.check_onset(normal, gross, self.first_frame)
            self.warnings += plausibility.check_growth(normal, gross)
        period_mm = self._period_px * self.inputs.mm_per_px
        self.about["gross_contact_area"] = {"ridge_period_mm": period_mm, "faint_rim_mm": self.faint_rim_mm}

    def restore(self, earlier: xr.Dataset) -> None:
        super().restore(earlier)
        self.faint_rim_mm = float(earlier["gross_contact_area"].attrs.get("faint_rim_mm", 0.0))

    def derive(self) -> None:
        """Compute deviations; those of areas and ellipse hold the faint rim of the contact, which all frames share."""
        super().derive()
        gross = np.where(self.series["gross_contact_area"] > 0, self.series["gross_contact_area"], np.nan)
        around, ratio = 2 * np.sqrt(np.pi * gross), self.series["real_contact_area"] / gross
        # Formulas hold the part that both areas show.
        rim_mm = np.sqrt(max(self.faint_rim_mm**2 - sparse_border_mm(ratio * gross, gross) ** 2, 0))
        rounded = self.inputs.scene.contact.rounded_share(self.inputs.mm_per_px) * ratio * gross
        off_mm2 = np.hypot(rounded, self._specks_mm2 * (not self._several_parts))
        for name, more in {
            "gross_contact_area_std": rim_mm * around,
            "real_contact_area_std": np.hypot(self._pale_rim_mm * around * ratio, off_mm2),
            "contact_area_ratio_std": np.hypot(max(rim_mm - self._pale_rim_mm, 0) * around * ratio, off_mm2) / gross,
            **dict.fromkeys(("ellipse_center_std", "ellipse_semi_axes_std"), rim_mm),
        }.items():
            if name in self.results:
                self.results[name][:] = np.hypot(self.results[name][:], np.nan_to_num(more))

    def cells(self) -> dict[str, float]:
        """Return the geometry of the grid of contact cells (square blocks of pixels) as attributes of result variables:
        side of a cell, and x or y of the centre of the first cell, in mm.
        """
        size = self.inputs.mm_per_px
        return {"cell_mm": self.cell_px * size, "first_cell_mm": (self.cell_px - 1) / 2 * size}

    def seeding_region(self, window_px: int) -> Mask:
        """Return the mask (h, w) of the skin to track: the gross contact in the frame with most contact, united with
        that of the first usable frame, which a contact that slides has left since.

        For slip it is dilated by a window, `window_px` of the topography view, so that points lie on both sides of the
        contact border.
        """
        region = self._largest | self._gross_region(self._contact(np.argmax(self.usable)))
        if self.inputs.scene.kind != "slip":
            return region
        away = cv2.distanceTransform((~region).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return away <= window_px * self.inputs.geometry.magnification

    def touched(self, frames: int = _LOOKS) -> Mask:
        """Return the union (h, w) of the gross contact masks in frames sampled from the whole recording."""
        return np.any([self._gross_region(self._contact(frame)) for frame in self._sampled_frames(frames)], axis=0)

    def _sampled_frames(self, frames: int = _LOOKS) -> Numbers:
        usable = np.flatnonzero(self.usable)
        return usable[np.unique(np.linspace(0, len(usable) - 1, min(len(usable), frames)).round().astype(int))]

    def _check_view(self, contact: FrameContact) -> None:
        """Warn of faults in the contact view in the frame with most contact (torn background, unlit glass, shadow,
        sweat), whose `contact` is given, and of glass that has moved in that, the first or the last usable frame.
        """
        region, light = self._largest, self._glass
        mask = contact.real_contact_mask
        assert mask is not None, "the engines of recordings return it"
        away = np.asarray(cv2.distanceTransform((~region).astype(np.uint8), cv2.DIST_L2, 3), np.float32)  # px
        frame = read_frames(self.inputs.recording[[self.reference_frame]])
        self.warnings += plausibility.check_clipped("contact", self._view.crop(frame))
        self.warnings += view_faults.check_background_lines(light)
        if region.any():
            radius_px = self.inputs.scene.contact.gross_radius_px
            self.warnings += view_faults.check_unlit_glass(region, self._light[0][0, 0], radius_px)
            self._specks_mm2 = float(mask[0, 0][away > radius_px].sum()) * self.inputs.mm_per_px**2
            if np.isfinite(self._period_px):
                counts, gain = self.inputs.counts(frame, self._view), float(contact.illumination_gain[0])
                lit = np.where(light > 0, light * (gain if np.isfinite(gain) else 1), np.nan)
                shadow = [*view_faults.check_shadow((counts[0] - self._black) / lit, away, self._period_px)]
                self.warnings += shadow or self._check_rim(counts, contact)
                self.warnings += view_faults.check_sweat(mask[0, 0], self._period_px)
        usable = np.flatnonzero(self.usable)
        frames = dict.fromkeys((usable[0], self.reference_frame, usable[-1]))
        pictures = ((number + self.first_frame, self._counts(number)[0] - self._black) for number in frames)
        self.warnings += view_faults.check_moved_glass(pictures, light, away)

    def _check_rim(self, counts: Array, contact: FrameContact) -> list[str]:
        """Measure the faint rim of the `contact` in a picture, and return a warning if there is one."""
        image = self._engine.images(counts)
        gross, self._pale_rim_mm = pale_rim(self._engine, image, self._light, contact, self._on_glass)
        assert contact.real_contact_mask is not None
        thin_rim_mm = view_faults.thin_rim_mm(contact.real_contact_mask[0, 0], self._largest, self._period_px)
        rim = max(self._pale_rim_mm, thin_rim_mm)
        radius = self.inputs.scene.contact.gross_radius_px
        averaged = np.interp(radius / self._period_px, *_AVERAGED)
        self.faint_rim_mm = float(max(rim, sparse_border_mm(contact.real_area_px, contact.gross_area_px), averaged))
        return [*check_faint_rim(rim, gross, float(contact.threshold[0]), radius, self._period_px)]

    def _leave_out_parts(self, contact: FrameContact, indices: Numbers, pixel_mm2: Series) -> None:
        """Store the real area outside the gross contact regions of a batch, and warn of a second contact there."""
        radius_px, cell_px = self.inputs.scene.contact.gross_radius_px, self.cell_px
        assert contact.real_contact_mask is not None
        masks, region = contact.real_contact_mask[:, 0], contact.density_margin[:, 0] > 0
        # Every pixel is looked at where sampled ones show a fourth of what is warned of.
        away = view_faults.outside_region(region.any(0), cell_px, radius_px)
        step = 2 * cell_px  # px between samples, each of which is read from a memory line of its own
        sampled = step**2 * np.count_nonzero(masks[:, ::step, ::step] & away[::2, ::2], axis=(1, 2))
        for k in ((self._second_px > 0) & (4 * sampled > self._second_px * view_faults.DENSITY)).nonzero()[0]:
            rows, columns = masks[k].shape
            cells = view_faults.outside_region(region[k], cell_px, radius_px)
            outside = masks[k] & cells.repeat(cell_px, 0)[:rows].repeat(cell_px, 1)[:, :columns]
            index, count = indices[k], int(outside.sum())
            self._outside[index] = count * pixel_mm2[k]
            if self.usable[index] and not self._several_parts and self._second_px < count / view_faults.DENSITY:
                frame = index + self.first_frame
                several = [*view_faults.check_second_contact(outside, self._second_px, radius_px, pixel_mm2[k], frame)]
                self._several_parts = bool(several)
                self.warnings += several

    def _gross_region(self, contact: FrameContact) -> Mask:
        return np.asarray(mask_of(torch.from_numpy(contact.density_margin), self.cell_px, *self._view.shape)[0, 0])

    def _counts(self, frame: int | np.integer) -> Array:
        """Return the picture (1, h, w) of the contact view in a frame, in which contact is dark."""
        return self.inputs.counts(read_frames(self.inputs.recording[[int(frame)]]), self._view)

    def _light_left(self, frame: int | np.integer) -> Array:
        """Return the ratio (K,) of a frame's light to that of the empty glass at samples of the scene's region, both
        above the black level and under the same illumination.
        """
        counts, unknown = self._counts(frame), np.full(1, np.nan, np.float32)  # this threshold detects no contact
        gain = float(self._engine.contact(self._engine.images(counts), self._light, unknown).illumination_gain[0])
        seen = self._samples(counts[0] - self._black)[self._lit]
        return seen / (self._light_of_lit * (gain if np.isfinite(gain) else 1))

    def _samples(self, picture: Array) -> Array:
        size = [side // _STEP for side in self._view.shape[::-1]]
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))

    def _changed(self, frame: int) -> tuple[float, float]:
        """Return the shares of the lit pixels that are clearly brighter, and clearly darker, in a frame than on the
        empty glass.
        """
        share = self._light_left(frame)
        count = max(share.size, 1)
        return (share > _BRIGHTER).sum() / count, (share < 1 / _BRIGHTER).sum() / count

    def _contact(self, frame: int | np.integer) -> FrameContact:
        return self._measure(self._engine.images(self._counts(frame)))

    def _measure(self, images: Images) -> FrameContact:
        threshold = None if self._threshold is None else np.full(len(images), self._threshold, np.float32)
        return self._engine.contact(images, self._light, threshold)

    def _most_contact(self) -> tuple[int, str]:
        """Return the usable frame that is expected to have most contact, and which that is in words: by the normal
        force or, where it is unknown or none, by the darkest contact view.
        """
        normal = self.known("normal_force")
        if normal is not None and (pressed := self.usable & (normal > plausibility.LEAST_NORMAL)).any():
            frame = int(np.argmax(np.where(pressed, normal, 0.0)))
            return frame, f"the largest force (frame {frame + self.first_frame})"
        # A contact leaves about half of the light.
        frame = int(min(self._sampled_frames(), key=lambda number: self._light_left(number).clip(0, 1).mean()))
        return frame, f"the darkest frame ({frame + self.first_frame})"

    def _fixed_threshold(self, faults: list[str]) -> float | None:
        """Return the contact threshold (relative intensity loss) for all frames; None if it differs by frame.

        Raises FingerflowError if there is no contact; it says what to check first, and contains the first of the
        `faults` of background or contrast, if there are some.
        """
        setting = self.inputs.scene.contact.threshold
        if setting == "per_frame":
            return None
        if not isinstance(setting, str):
            return setting
        frame = self._counts(self.reference_frame)
        threshold = self._engine.contact(self._engine.images(frame), self._light).threshold[0]
        if not np.isfinite(threshold):
            path = self.inputs.recording.path
            if faults:
                raise FingerflowError(f"{path}: no contact: {faults[0]}")
            shown = frame[0] - self._black, self._glass, self.reference_frame + self.first_frame
            seen = next(view_faults.check_empty_view(*shown), "nothing there differs from the background as it does")
            raise FingerflowError(
                f"{path}: no contact at {self.moment}: {seen}. Check frame rate and trigger, then [views.contact] "
                f"and [background] in {self.inputs.scene.path}; or set [contact] threshold to a number"
            )
        return threshold
