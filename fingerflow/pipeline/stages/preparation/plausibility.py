"""Plausibility checks of results and settings; each check yields warnings that state a remedy."""

from collections.abc import Iterator

import numpy as np

from fingerflow.kernels.array_types import Array, Mask, Series
from fingerflow.kernels.field_limits import LEAST_SHARE

_FEW_RIDGES_MM2 = 1.0
# Largest share of impulses among pixels; with twice as many 0.3 % of the positions are off by four deviations.
_IMPULSES = 5e-4
# Shares of the requested points found, and of the points tracked, below which a warning is given, and of points held
# back by dust, above which it is: a single point may be held at an edge of slip.
_FEW_FOUND, _FEW_TRACKED, _HELD = 0.9, 0.5, 0.0025
_UNSEEDED = 0.05  # share of the contact far from the region of seeding, above which a warning is given
# Most gauge length in widths of the contact: medians on a print were wrong by 3 to 4 deviations at 0.41, by 1 at 0.2.
_MOST_GAUGE = 1 / 3
# Plausible values for fingertips, with a margin for every hand and laboratory.
_RIDGE_MM = (0.3, 0.7)  # mm, ridge period: 0.46 mm on average in adults, from a child's to a broad thumb's
LEAST_NORMAL = 0.05  # N, least normal force for T/N: ten times the noise of a sensor; below, noise dominates T/N
_MOST_FORCE = 100.0  # N, peak normal force of one finger: maximal pinch forces are 50 to 100 N
_PRESSURE_KPA = (1.0, 300.0)  # kPa, normal force over gross area at the peak: 5 to 100 kPa at 0.1 to 20 N
_YOUNG_MPA = (0.005, 20.0)  # MPa, Young's modulus: skin and pulp in vivo have 0.01 to 3 MPa, gels from 0.005 MPa
# Most tangential over normal force where a finger presses: friction coefficients of wet fingertips reach 5.
_MOST_LOAD_RATIO = 10.0
# Least distance of a single sample from both neighbours, in N, as a share of the range of the force and in multiples of
# the mean one, above which it is none of a finger.
_SPIKE_N, _SPIKE_SHARE, _SPIKE_NOISE = 0.2, 0.25, 20
# Largest force of a sensor where nothing touches, in N and as a share of the peak force.
_FORCE_OF_NOTHING = (0.05, 0.01)
_NOISE = 0.005  # N, noise of a force at the frame rate
_AREA_BY_FORCE = 1 / 3  # exponent of the gross area as a power of the force: this or a higher one, up to Hertz's 2/3
_SAFE = 1.5  # factor on the area expected by that law, above which a warning is given
# Least ratio by which the force rises over the last tenth of the frames; least d ln(area) / d ln(force), 0.1 to 2/3 for
# skin.
_RISES, _FOLLOWS = 1.1, 0.05
_GROWN = 0.9  # share of the largest area at which a contact has grown
_STEPS = 4  # least frames in which a contact grows to 0.9 of its area: in 3, medians err by five deviations
# Least number and share of samples at the limit of a saturated force sensor, least ratio to the samples at the next
# value, and least share of changes of direction from sample to sample below it, by which noise is seen.
_AT_LIMIT, _AT_LIMIT_SHARE, _PILED_UP, _NOISY = 20, 0.005, 5, 0.2
_CLIPPED = 0.01  # share of saturated pixels in a view above which a warning is given
ALL_CHANGED = 0.95  # share of brighter, or of darker, pixels above which the light differs, not what lies on the glass
# Share of the lit view in which a frame is brighter than the background, above which the background is wrong.
_BRIGHTER_SHARE = 0.005


def check_ridges(period_px: float, mm_per_px: float) -> Iterator[str]:
    """Yield a warning if the ridge period (px) at the calibrated image scale is not that of a finger; none for NaN."""
    period, (least, most) = period_px * mm_per_px, _RIDGE_MM
    if np.isfinite(period) and not least <= period <= most:
        yield (
            f"calibration.mm_per_px = {mm_per_px:g} puts the ridges {period:.2g} mm apart, and those of fingers are "
            f"{least:g} to {most:g} mm apart: the scale is wrong, as where a diameter is taken for a radius, and "
            f"lengths and areas with it; calibrate again"
        )


def check_views(mirroring: str, offset_px: float, mm_per_px: float) -> Iterator[str]:
    """Yield a warning if the topography view shows the ridges of the contact view only when turned over by
    `mirroring`, or if the calibration maps them `offset_px` px beside these; both are of `ridges.compare_views`.
    """
    if mirroring:
        yield (
            f"the topography view is mirrored: it shows the ridges of the contact view only if turned over "
            f"{mirroring}. Onsets are those of skin elsewhere, and displacements and curl wrong; calibrate again"
        )
    elif offset_px:
        yield (
            f"calibration.topography_to_contact puts the ridges of the topography view {offset_px * mm_per_px:.2g} mm "
            f"beside those of the contact view. Onsets and fields are those of skin elsewhere; calibrate again"
        )


def check_clipped(view: str, counts: Array) -> Iterator[str]:
    """Yield a warning if many pixels of a picture of `view` have the largest grey level of 8 or more bits."""
    level = int(counts.max())
    share = (counts == level).mean()
    unit = level & -level  # of counts in the upper bits of a pixel
    if share > _CLIPPED and level > 254 * unit and not level & (level + unit):
        yield (
            f"{share:.0%} of the {view} view is saturated: its grey level is {level}, the largest there is. Texture "
            f"and loss of light are not seen there, and points and areas are wrong. Lower exposure, gain or light"
        )


def check_contrast(brighter: float, darker: float, appears: str, moment: str) -> Iterator[str]:
    """Yield a warning if contact `appears` dark by the settings and bright in the frame with most contact, or the
    other way round.

    `brighter` and `darker` are shares of that frame's pixels beside the empty glass, after the negative of bright
    contact was taken; `moment` says in words which frame it is.
    """
    if brighter > _BRIGHTER_SHARE and brighter > darker:
        opposite, lighter = ("bright", "brighter") if appears == "dark" else ("dark", "darker")
        yield (
            f"at {moment} {brighter:.0%} of the contact view is {lighter} than the empty glass and {darker:.0%} "
            f'changed as contact does, with contact.appears = "{appears}": check [views.contact] and '
            f'background.frames, or set contact.appears = "{opposite}" if the finger is there'
        )


def check_background(brighter: float, darker: float, frame: int) -> Iterator[str]:
    """Yield a warning if a large share `brighter` of the pixels in the first usable frame is brighter than without a
    finger, or most are `darker`.
    """
    for share, change, least in ((brighter, "darker", _BRIGHTER_SHARE), (darker, "brighter", ALL_CHANGED)):
        if share > least:
            yield (
                f"background.frames is {change} than frame {frame} in {share:.1%} of the contact view: it was recorded "
                f"at another exposure, gain or light, or with a finger on the glass. Areas are wrong; record the empty "
                f"glass again with the camera settings of the recording, and check [views.contact]"
            )


def check_young_modulus(modulus_mpa: float) -> Iterator[str]:
    """Yield a warning if a Young's modulus is implausible for skin."""
    least, most = _YOUNG_MPA
    if not least <= modulus_mpa <= most:
        yield (
            f"fields.young_modulus_mpa = {modulus_mpa:g} is outside the {least:g} to {most:g} MPa of skin: give MPa, "
            f"not kPa or Pa. Strain energies are proportional to it"
        )


def check_force(normal: Series) -> Iterator[str]:
    """Yield a warning if a normal force (frames,) N is larger than a finger can exert, or stays at zero."""
    peak = np.fmax.reduce(normal)
    if peak <= LEAST_NORMAL:
        yield f"the normal force in the frames is never above {LEAST_NORMAL} N: check frame rate, trigger and column"
    if peak > _MOST_FORCE:
        yield (
            f"the normal force reaches {peak:,.0f} N, and no finger presses with more than {_MOST_FORCE:g} N: is it in "
            f"mN or g? Give [forces] units, or check gain"
        )


def check_saturation(force: Series, name: str) -> Iterator[str]:
    """Yield a warning if samples of a force in N pile up at its largest value, while those below it are noisy: the
    sensor, or its amplifier, is saturated. Without noise a steady force gives equal samples, too.
    """
    size = np.abs(force[np.isfinite(force)])
    largest = size.max(initial=0.0)
    step = np.diff(size[size < largest])
    if len(step) > 1 and np.mean(step[1:] * step[:-1] < 0) > _NOISY:
        many, beside = (size == largest).sum(), (size == size[size < largest].max()).sum()
        if many > max(_AT_LIMIT, _AT_LIMIT_SHARE * size.size, _PILED_UP * beside):
            yield (
                f"{many} of {size.size} samples of the {name.replace('_', ' ')} are {largest:.4g} N, none is larger: "
                "the sensor or its amplifier is saturated, and the true force larger. Raise its range, or press less"
            )


def check_spikes(force: Series, name: str) -> Iterator[str]:
    """Yield a warning if single samples of a force in N lie far from both neighbours, as a disturbance of the cable
    leaves them.
    """
    force = force[np.isfinite(force)]
    middle = np.median(np.stack((force[:-2], force[1:-1], force[2:])), axis=0)
    away = np.abs(force[1:-1] - middle)
    if away.size and away.max() > max(_SPIKE_N, _SPIKE_SHARE * np.ptp(middle), _SPIKE_NOISE * away.mean()):
        yield (
            f"a single sample of the {name.replace('_', ' ')} lies {away.max():.3g} N from both beside it: no finger "
            "does that, and the force is wrong in the frames around it. Check cable and ground, and remove the sample"
        )


def check_load_ratio(ratio: Series, normal: Series) -> Iterator[str]:
    """Yield a warning if tangential over normal force is larger than friction allows where the normal force (frames,)
    is above half of its largest.
    """
    pressed = ratio[normal > max(LEAST_NORMAL, np.fmax.reduce(normal) / 2)]
    if len(pressed) and (most := float(np.median(np.abs(pressed)))) > _MOST_LOAD_RATIO:
        yield (
            f"the tangential force is {most:.3g} times the normal one, and skin slips before {_MOST_LOAD_RATIO:g}: are "
            "both in one unit, and the columns not exchanged? Check [forces] normal, tangential, units and gain"
        )


def check_pressure(normal: Series, gross: Series) -> Iterator[str]:
    """Yield a warning if the mean pressure, from forces (N) and gross areas (mm^2), is implausible for a fingertip."""
    touching = np.isfinite(normal) & (gross > 0)
    if not touching.any():
        return
    frame = np.argmax(np.where(touching, normal, -np.inf))
    force, area, (least, most) = normal[frame], gross[frame], _PRESSURE_KPA
    pressure = 1000 * force / area
    if not least <= pressure <= most:
        yield (
            f"the largest normal force, {force:,.3g} N on {area:.3g} mm², is a mean pressure of {pressure:,.3g} kPa; "
            f"fingertips have {least:g} to {most:g}: check [forces] units (mN, g), gain, and calibration.mm_per_px"
        )


def check_onset(normal: Series, gross: Series, first_frame: int) -> Iterator[str]:
    """Yield a warning if contact (gross areas in mm^2) and normal force (N) do not begin in the same frame.

    Force without contact counts everywhere; contact without force only until the force is largest, as skin that lets go
    adheres. The area that needs no measurable force follows from A ~ F^(1/3).
    """
    measured = np.isfinite(normal) & np.isfinite(gross)
    if not (gross[measured] > 0).any():
        return
    force, area = np.where(measured, normal, 0.0), np.where(measured, gross, 0.0)
    peak, largest = force.max(), area.max()
    nothing = measured & (area == 0)
    least, share = _FORCE_OF_NOTHING
    pressing = nothing & (np.abs(force) > max(least, share * peak))
    noise = max(_NOISE, 5 * float(force[nothing].std())) if nothing.sum() > 2 else _NOISE
    light = measured & (force < noise) & (np.arange(len(force)) <= int(np.argmax(force)))
    unloaded = np.where(light, area, 0.0)
    if pressing.any():
        frame = np.argmax(np.where(pressing, np.abs(force), 0))
        number, many = frame + first_frame, int(pressing.sum())
        what = f"normal force is {force[frame]:.2g} N in frame {number}, where nothing touches (in {many} frames)"
    elif peak >= 10 * noise and unloaded.max() > _SAFE * largest * (noise / peak) ** _AREA_BY_FORCE:
        frame = np.argmax(unloaded)
        where = f"in frame {frame + first_frame}, where the normal force is {force[frame]:.2g} of {peak:.2g} N"
        what = f"contact has {area[frame]:.2g} of its {largest:.2g} mm² {where}"
    else:
        return
    yield (
        f"the {what}: force and pictures are not of the same moments, or the sensor has another zero. Check "
        f"recording.trigger_frame and forces.trigger_level, recording.frame_rate, and forces.offset or tare"
    )


def check_growth(normal: Series, gross: Series) -> Iterator[str]:
    """Yield a warning if the contact area (mm^2) stops growing at the end of a recording while the force (N) rises."""
    measured = np.flatnonzero(np.isfinite(normal) & np.isfinite(gross))
    last = measured[len(measured) - len(measured) // 10 :]
    if len(last) < 4:
        return
    parts = np.array_split(last, 3)
    (force, more), (area, larger) = ([series[part].mean() for part in parts[::2]] for series in (normal, gross))
    if force > _NOISE and area > 0 and more >= _RISES * force and larger <= area * (more / force) ** _FOLLOWS:
        yield (
            f"at the end the normal force rises from {force:.2g} to {more:.2g} N, and the contact no longer grows "
            f"({larger:.3g} mm²): the force is of an earlier moment, or the contact fills the view. Check "
            f"recording.frame_rate and trigger_frame, and [views.contact]"
        )


def check_growth_time(gross: Series) -> Iterator[str]:
    """Yield a warning if a contact grows to nearly its largest area (mm^2) in few frames."""
    area = np.nan_to_num(gross)
    touches, grown = int(np.argmax(area > 0)), int(np.argmax(area >= _GROWN * area.max(initial=0.0)))
    if touches and grown - touches < _STEPS:
        yield (
            f"the contact grows to its size in {grown - touches} frames: skin moves far between touching and the frame "
            f"that shows it, and displacement, medians and energy err by more than stated. Record at a higher frame "
            f"rate, or press more slowly"
        )


def check_areas(real: Series, gross: Series, radius_px: int, first_frame: int) -> Iterator[str]:
    """Yield a warning if the real contact area exceeds the gross area; areas in mm^2.

    Of a contact that has less than a few ridges, the deviation of the gross area says so.
    """
    more = np.flatnonzero((real > gross) & (gross > _FEW_RIDGES_MM2))
    if len(more):
        yield (
            f"in {len(more)} frames, the first is {more[0] + first_frame}, the real contact area exceeds the gross one "
            f"({real[more[0]]:.3g} and {gross[more[0]]:.3g} mm²): raise contact.gross_radius_px = {radius_px}"
        )


def check_points(seeded: int, requested: int, min_distance_px: float, region_px: float) -> Iterator[str]:
    """Yield a warning if far fewer points were seeded than requested, in a region of `region_px` pixels."""
    if seeded < _FEW_FOUND * requested:
        # Upper bound of the number of points: one for each square of side `min_distance_px`.
        room = round(region_px / min_distance_px**2)
        yield (
            f"{seeded} of {requested} points were found: the region of {region_px} px has room for {room} that lie "
            f"{min_distance_px:g} px apart, as far as corners stand out of the noise. Check focus and light, make the "
            f"region larger, or lower tracking.min_distance_px or tracking.points"
        )


def check_seeded_region(outside: float) -> Iterator[str]:
    """Yield a warning if a share `outside` of the contact lies far from the region in which points are seeded."""
    if outside > _UNSEEDED:
        yield (
            f"{outside:.0%} of the contact lies outside the region in which points are seeded: medians and energy are "
            f"of the rest. Make [stream] region or views.topography.region as large as the contact"
        )


def check_tracking(tracked: Series, held: Series, first_frame: int) -> Iterator[str]:
    """Yield warnings if few points are tracked, and if something that rests on the glass, such as dust, holds points
    back.

    `tracked` and `held` (frames,) are the shares of these points, NaN without points.
    """
    few, dust = np.flatnonzero(tracked < _FEW_TRACKED), np.flatnonzero(held > _HELD)
    if len(few):
        yield (
            f"less than half of the points are tracked in {len(few)} frames, the first is {few[0] + first_frame} "
            f"({tracked[few[0]]:.0%}): what is known there is of the rest alone. status says why each was lost"
        )
    if len(dust):
        yield (
            f"something rests on the glass while the skin moves, as dust does: up to {np.max(held[dust]):.1%} of the "
            f"points were held back, in {len(dust)} frames, the first is {dust[0] + first_frame}, and are NaN there "
            f"(status dust_in_window). Clean the glass"
        )


def check_impulses(share: float) -> Iterator[str]:
    """Yield a warning if a large fraction `share` of the pixels of the topography view differs from all pixels around
    (salt-and-pepper noise).
    """
    if share > _IMPULSES:
        yield (
            f"{share:.2%} of the pixels of the topography view differ from all pixels around (salt and pepper): points "
            f"are lost, or off by more than stated. Is the sensor defective, or the file damaged?"
        )


def check_fields(median: Series, coverage: Series, gross: Series, gauge_mm: float, first_frame: int) -> Iterator[str]:
    """Yield a warning if the median of a deformation field over the contact is NaN in frames whose contact is more
    than two gauge lengths wide.

    `median` and `coverage` (frames,) are a median over the contact, and the share of the contact in which fields are
    known; `gross` is the gross area, mm^2.
    """
    unknown = np.flatnonzero(np.isnan(median) & (gross > np.pi * gauge_mm**2))
    if len(unknown):
        share = np.nan_to_num(coverage[unknown[0]])
        yield (
            f"medians of divergence, curl and strain are NaN in {len(unknown)} frames with contact, the first is "
            f"{unknown[0] + first_frame}, and in part the strain energy: fields are known in {share:.0%} of the "
            f"contact, not in {LEAST_SHARE:.0%} (field_coverage). Points are lost (status), or none were seeded there: "
            f"see [views.topography] and its region, [stream] region, tracking.points and fields.gauge_length_mm"
        )


def check_energy(gross: Series, misfit: Mask, gauge_mm: float, first_frame: int) -> Iterator[str]:
    """Yield a warning if no smooth field explains the displacements (`misfit`) in frames whose contact is two gauge
    lengths wide.
    """
    misfits = np.flatnonzero(misfit & (gross > np.pi * gauge_mm**2))
    if len(misfits):
        yield (
            f"no smooth field explains the displacements well in {len(misfits)} frames with contact, the first is "
            f"{misfits[0] + first_frame}: skin slips, or points err more than stated. The strain energy lacks some"
        )


def check_gauge(gauge_mm: float, contact_mm: float) -> Iterator[str]:
    """Yield a warning if the gauge length is large beside the least diameter `contact_mm` of the largest contact."""
    if gauge_mm > _MOST_GAUGE * contact_mm:
        most_mm = np.floor(100 * _MOST_GAUGE * contact_mm) / 100  # rounded down, so that it brings no warning itself
        yield (
            f"fields.gauge_length_mm = {gauge_mm:g} is over a third of the width of the contact ({contact_mm:.2g} mm): "
            f"fields are smoothed by more than their deviations state. Take {most_mm:g} mm or less"
        )
