"""Memory of a GPU that the torch engine needs for recordings computed together.

`python -m bench gpu` counts it: `peak_MB` are the most bytes alive at a time in a step of the portable form, for each
frame. A captured step keeps its memory (`engines.capture`), so that the steps add up.
"""

TOGETHER = 32  # largest number of recordings computed together: more gain nothing by the counts of `bench gpu`
FRAMES = 8  # frames of a recording per call that computes contact or tracks points
_FRAMES_OF_FIELDS = 64  # frames of a recording per call that computes fields
_PIXEL = 30.0  # bytes per pixel of a frame: contact, light, black level, and the frame itself in 32 bit
# Bytes per sample of a template: prepared, kept, copied for all recordings and for a captured graph, tracked.
_SAMPLE = 160.0
_PAIR = 20.0  # bytes per pair of points in a frame, for deformation or fields
_UPDATED = 1e9  # bytes for a template update, whatever the number of recordings (`ops.pieces`)
_SHARE = 0.7  # usable share of the free memory; libraries and fragmentation take the rest


def recordings_that_fit(free: float, height: int, width: int, points: int, window_px: int) -> int:
    """Return how many recordings are computed together in `free` bytes of memory: one to `TOGETHER`.

    Their views have height x width px, and their points windows of `window_px`.
    """
    shared = _UPDATED + _FRAMES_OF_FIELDS * points**2 * _PAIR
    fitting = int((_SHARE * free - shared) / bytes_of_recording(height, width, points, window_px))
    return min(max(1, fitting), TOGETHER)


def bytes_of_recording(height: int, width: int, points: int, window_px: int) -> float:
    """Return the GPU memory, bytes, that one of several recordings computed together needs, from the image size, the
    number of points and the side of the tracking window.
    """
    of_frame = height * width * _PIXEL + points**2 * _PAIR
    return FRAMES * of_frame + points * window_px**2 * _SAMPLE
