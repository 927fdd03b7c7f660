"""Statuses and limits of tracking; `kernels/generate_limits.py` writes the header of C++ from them."""

from enum import IntEnum


class TrackStatus(IntEnum):
    """Why a point has a position, or has none: the first reason that applies.

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
    OFF_NEIGHBOURS = 8  # it was found, but not where any plane through its neighbours leads
    FRAME_NOT_USABLE = 9  # the frame is no picture of the trial (`pipeline.stages.preparation.frame_check`)
    WINDOW_DIFFERS = 10  # its window is no longer the one that was seeded (`tracker.subset_verification`)
    NOT_SEEDED_YET = 11  # seeded in a later frame, as skin came into contact there (`pipeline.stages.tracking`)


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
    LEAN = 11  # eight: d x / d E, then d y / d E, by xx, xy, yx, yy of a deformation E that the template does not know
    COVARIANCE_XX = 19  # of a position, px^2, for white noise of variance 1 in the pixels of one image
    COVARIANCE_XY = 20
    COVARIANCE_YY = 21
    BENDING = 22  # ten: of what E leaves in the residual, grey levels^2, by xx xx, xx xy, ... yx yy, yy yy


NUMBERS = 32

# Share of a template's variance, noise discounted, that a match may leave unexplained.
MISMATCH_SHARE = 0.05

# A window has texture in every direction if its weaker gradient energy is this many times what noise alone gives it.
TEXTURE_TO_NOISE = 2.0
# The same against the mean of both directions: rounding gives a grating a second one.
LEAST_TEXTURE = 1e-4
# What white pixel noise of variance 1 leaves in the spline's value and in a component of its gradient. They depend on
# the fractional position by 2 % and less.
VALUE_NOISE, GRADIENT_NOISE = 0.0907, 0.0488
# px, the longest step in x and in y; and the step below which a point is found: what it misses by is a hundredth of it
# (window 25) to a fortieth (window 11), a fifteenth of a standard deviation at most. With 0.25 px numbers hung on where
# points were expected: one frame or two ahead, they differed by up to 0.03 px.
REACH, LAST_STEP = 1.0, 0.1
# Steps at most that look for a point, each from where the one before has led.
ROUNDS = 8
# Contrast of an image over that of the template, or the reverse, up to which flow follows it. A step follows any down
# to the least; where contrast is reversed it leads away, eight times as far as with a gain of 1.
MOST_GAIN, LEAST_GAIN = 8.0, 1e-3
# px that a window may lie beyond the border of a frame: what is at rest on whole pixels lies on the limit itself, and
# rounding would decide on which side.
SLACK = 1e-3
# Share of the highest correlation of a search by which others are no lower: of equal places, as in saturated skin or
# along a straight edge, the one nearest to the guess is taken, not the one that rounding favours.
SEARCH_TIE = 1e-4
# Frames that the speed of a lost point is good for, and the weight of the latest displacement in a speed.
SPEED_FRAMES, SPEED_WEIGHT = 4.0, 0.5
# px over which the deformation of a template is taken to be uniform.
WARP_GAUGE_PX = 120.0
# px that a deformation may shift the edge of a window before its template is updated. What leans, and what the residual
# owes to it, is taken off: on a press positions are as exact at 0.2 px, for half of the templates. But which templates
# exceed the limit turns on a digit, and then two engines differ by up to 0.009 px, not 3e-5 as here.
UPDATE_PX = 0.1
# Variance that whole grey levels have against the light.
ROUNDING = 1 / 12
