"""Statuses and limits of tracking; `kernels/generate_limits.py` writes the header of C++ from them."""

from enum import IntEnum


class TrackStatus(IntEnum):
    """Status of a tracked point: tracked, or the first reason that applies why it has no position.

    `ops.tracking.templates` gives up to FORWARD_BACKWARD (LEFT_FRAME for a window that does not lie inside both images,
    whatever its pixels are), `ops.tracking.outliers` UNCERTAIN and OFF_NEIGHBOURS; the others are those of a recording.
    """

    TRACKED = 0
    NOT_FINITE = 1  # the given position, or a pixel within 3 px of the window of either image, is NaN or infinite
    LEFT_FRAME = 2  # the window does not lie inside both images
    NO_TEXTURE = 3  # blank, saturated, or structured in one direction only (aperture problem)
    NOT_CONVERGED = 4  # no root of the normal equations near the prediction
    MISMATCH = 5  # what was found looks different from the template
    FORWARD_BACKWARD = 6  # tracking back does not return to the start
    UNCERTAIN = 7  # its standard deviation is far above that of its neighbours
    OFF_NEIGHBOURS = 8  # found, but its displacement disagrees with that of its neighbours
    FRAME_NOT_USABLE = 9  # the frame is not usable (`pipeline.stages.preparation.frame_check`)
    WINDOW_DIFFERS = 10  # its window is no longer the one that was seeded (`tracker.subset_verification`)
    NOT_SEEDED_YET = 11  # seeded in a later frame, as skin came into contact there (`pipeline.stages.tracking`)
    DUST_IN_WINDOW = 12  # held back by something in its window that rests on the glass (`tracker.subset_verification`)


class Number(IntEnum):
    """Indices of template statistics in `Templates.numbers`."""

    INVERSE_XX = 0  # of the matrix sum g g', px^2 a grey level^2
    INVERSE_XY = 1
    INVERSE_YY = 2
    ENERGY = 3  # sum of the squared values
    LEVEL = 4  # mean grey level, taken off the values
    CONSTANT_X = 5  # sum of g times the values
    CONSTANT_Y = 6
    NOISE = 7  # variance of a pixel's white noise
    TEXTURED = 8  # 1 where the texture stands out of the noise in every direction, else 0
    INSIDE = 9  # 1 where the window lies in the image, else 0
    GAIN = 10  # 1 where gain and offset are free, 0 where they are not
    LEAN = 11  # eight: d x / d E, then d y / d E, by xx, xy, yx, yy of a deformation E not contained in the template
    COVARIANCE_XX = 19  # of a position, px^2, for white noise of variance 1 in the pixels of one image
    COVARIANCE_XY = 20
    COVARIANCE_YY = 21
    BENDING = 22  # ten: residual due to E, grey levels^2, by xx xx, xx xy, ... yx yy, yy yy


NUMBERS = 32

# Share of a template's variance, noise discounted, that a match may leave unexplained.
MISMATCH_SHARE = 0.05

# A window has texture in every direction if its weaker gradient energy exceeds that of noise alone by this factor.
TEXTURE_TO_NOISE = 2.0
# The same limit relative to the mean of both directions: by rounding a grating has some energy in its second direction.
LEAST_TEXTURE = 1e-4
# Noise variance of the spline's value and of a gradient component, for white pixel noise of variance 1. Both vary with
# the fractional position by at most 2 %.
VALUE_NOISE, GRADIENT_NOISE = 0.0907, 0.0488
# px, longest step in x and in y, and step below which a point counts as found. The remaining error is a hundredth of
# that step (window 25) to a fortieth (window 11), at most a fifteenth of a standard deviation. With 0.25 px, positions
# depended on the prediction: they differed by up to 0.03 px between predictions from one and from two frames before.
REACH, LAST_STEP = 1.0, 0.1
# Largest number of steps per point; each step starts at the result of the one before.
ROUNDS = 8
# Largest ratio of image contrast to template contrast, or the reverse, that dense flow accepts. A registration step
# accepts any gain down to the second limit; for reversed contrast it leads away, eight times as far as for a gain of 1.
MOST_GAIN, LEAST_GAIN = 8.0, 1e-3
# px by which a window may extend beyond a frame: a window at rest on whole pixels lies exactly on the limit, where
# rounding would decide.
SLACK = 1e-3
# Relative difference of correlations that count as equal in a search, as in saturated skin or along a straight edge. Of
# equal ones the position nearest to the guess is taken.
SEARCH_TIE = 1e-4
# Frames over which the speed of a lost point decays, and weight of the latest displacement in a speed.
SPEED_FRAMES, SPEED_WEIGHT = 4.0, 0.5
# px over which the deformation of a template is assumed to be uniform.
WARP_GAUGE_PX = 120.0
# Share of that gauge over which the gradient is fitted again, to extrapolate it to a gauge of 0. At 1/2, positions are
# as noisy as by the whole gauge alone; beside a slip border their error is 0.6 of it.
INNER_GAUGE = 0.5
# px by which a deformation may shift the edge of a window before its template is updated. Bias and residual due to the
# deformation are corrected, so that 0.2 px would give equally exact positions on a press, with half of the templates.
# But rounding decides which templates exceed the limit, and two engines would differ by up to 0.009 px instead of 3e-5.
UPDATE_PX = 0.1
# Variance of the rounding to whole grey levels.
ROUNDING = 1 / 12
# Product of the variances of two windows, grey levels^4, below which one of them counts as blank.
LEAST_VARIANCE = 1e-12
# Reweightings of a fit of the shift of a window; residual, in standard deviations, beyond which a sample has no weight
# (Tukey's biweight); standard deviation over the median of the magnitudes.
WEIGHT_ROUNDS, TUKEY, MAD = 4, 4.685, 1.4826
