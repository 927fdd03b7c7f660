"""Statuses and limits of tracking: the one list, from which `kernels/generate_limits.py` writes what C++ reads."""

from enum import IntEnum


class TrackStatus(IntEnum):
    """Why a point has a position, or has none. The first reason that applies is given; of a window that does not lie
    inside both images LEFT_FRAME, whatever its pixels are.
    """

    TRACKED = 0
    NOT_FINITE = 1  # the given position, or a pixel within 5 px of the window of either image, is NaN or infinite
    LEFT_FRAME = 2  # the window does not lie inside both images
    NO_TEXTURE = 3  # blank, saturated, or structured in one direction only (aperture problem)
    NOT_CONVERGED = 4  # no root of the normal equations near the prediction
    MISMATCH = 5  # what was found looks different from the template
    FORWARD_BACKWARD = 6  # tracking back does not return to the start
    UNCERTAIN = 7  # its standard deviation is far above that of its neighbours
    OFF_NEIGHBOURS = 8  # it was found, but not where any plane through its neighbours leads
    FRAME_NOT_USABLE = 9  # the whole frame is no picture of the trial: a recording's results have it, no op gives it
    WINDOW_DIFFERS = 10  # its window is no longer the one that was chosen (`stages.second_look`); no op gives it either
    NOT_CHOSEN_YET = 11  # it was chosen in another frame, as skin came into contact there (`stages.new_skin`); no op


class Number(IntEnum):
    """Places in `Templates.numbers`, what the equations need of a template besides its samples."""

    INVERSE_XX = 0  # of the matrix sum g g', px^2 a grey level^2
    INVERSE_XY = 1
    INVERSE_YY = 2
    ENERGY = 3  # sum of the squared values
    LEVEL = 4  # mean grey level, taken off the values
    PIXELS_X = 5  # what the pixels' weights give for a blank picture of that level
    PIXELS_Y = 6
    CONSTANT_X = 7  # sum of g times the values
    CONSTANT_Y = 8
    NOISE = 9  # variance of a pixel's white noise
    TEXTURED = 10  # 1 where the texture stands out of the noise in every direction, else 0
    INSIDE = 11  # 1 where the window lies in the image, else 0
    GAIN = 12  # 1 where gain and offset are free, 0 where they are not
    LEAN = 13  # eight: d x / d E, then d y / d E, by xx, xy, yx, yy of a deformation E that the template does not know
    COVARIANCE_XX = 21  # of a position, px^2, for white noise of variance 1 in the pixels of one image
    COVARIANCE_XY = 22
    COVARIANCE_YY = 23
    BENDING = 24  # ten: of what E leaves in the residual, grey levels^2, by xx xx, xx xy, ... yx yy, yy yy


NUMBERS = 34

# Whole shifts of a template's table on either side, and so many samples more than the window around it; its numbers.
BEYOND = 2
TABLE = 3 * (2 * BEYOND + 1) ** 2

# Share of a template's variance, noise discounted, that a match may leave unexplained.
MISMATCH_SHARE = 0.05

# A window has texture in every direction if its weaker gradient energy is this many times what noise alone gives it.
TEXTURE_TO_NOISE = 2.0
# The same against the mean of both directions: rounding gives a grating a second one.
LEAST_TEXTURE = 1e-4
# What white pixel noise of variance 1 leaves in the spline's value and in a component of its gradient. They depend on
# the fractional position by 2 % and less.
VALUE_NOISE, GRADIENT_NOISE = 0.0907, 0.0488
# px from the whole pixel that is nearest to the prediction, in x and y, within which a point is found.
REACH = 1.0
# px that a window may lie beyond the border of a frame, or a point beyond REACH: what is at rest on whole pixels, or
# has moved by one, lies on the limit itself, and rounding would decide on which side.
SLACK = 1e-3
# px that the initial estimate may lead, and its steps: each leaves a fifth of the error far from the root, less near.
ESTIMATE_REACH, ESTIMATE_STEPS = 1.5, 3
# Contrast of an image over that of the template, or the reverse.
MOST_GAIN = 8.0
# px, the step of the refinement: a longer one says that the initial estimate did not find what is there.
LAST_STEP = 0.25
# Share of the highest correlation of a search by which others are no lower: of equal places, as in saturated skin or
# along a straight edge, the one nearest to the guess is taken, not the one that rounding favours.
SEARCH_TIE = 1e-4
# Frames that the speed of a lost point is good for, and the weight of the latest displacement in a speed.
SPEED_FRAMES, SPEED_WEIGHT = 4.0, 0.5
# How often a point that lies further off than a look reaches is looked for, each time where this has led.
ROUNDS = 5
# px over which the deformation of a template is taken to be uniform.
WARP_GAUGE_PX = 120.0
# Variance that whole grey levels have against the light.
ROUNDING = 1 / 12
