// What fingerflow/kernels calls, declared once: Python reads this file too (fingerflow/kernels/declarations.py), and the
// entries that it calls are written from it (kernels/generate_entries.py). Arguments go by name, those of a structure among
// the others, so a name stands once in a function. Shapes, strides and dtypes are checked in Python. Strides are in pixels.
// What a function throws becomes an exception of Python's.
#pragma once

#include <cstdint>

// Frames (batch, height, width) of a kind of pixels.h; the pixels of a row are contiguous.
struct fingerflow_frames {
    const void* data;
    std::int64_t batch, height, width, frame_stride, row_stride, kind;
};

// The widest instruction set in use from now on: 0 for the baseline of the processor's kind, 1 for AVX2, 2 for AVX-512,
// -1 for all that the processor has; `taken` is the one in use then. For tests; every set gives the same answers.
void fingerflow_limit_instruction_set(int most, std::int32_t* taken);

// For tests: faults and threads of parallel.h, by their numbers.
void fingerflow_inject_fault(int fault, std::int64_t piece, int thread);

// Medians of size x size windows of uint8 or uint16 frames; `medians` is contiguous. `table` is null for a compiled size,
// else what fingerflow/kernels/median_rows.py writes for it.
void fingerflow_median(const fingerflow_frames* frames, void* medians, int size, const std::uint16_t* table, int threads);

// Templates of `points` of each image prepared, as fingerflow/ops/tracking/templates.py describes; all contiguous. Of P =
// images x points: start (P, 2), NaN is written where there is no point; inverse_warp (P, 2, 2) or null, samples
// (P, 3, window, window), numbers (P, 32); variance one an image.
struct fingerflow_prepared_templates {
    fingerflow_frames image;
    float* start;
    const float *inverse_warp, *variance;
    float *samples, *numbers;
    std::int64_t points;
    std::int32_t window, gain_offset;
    float rounding;
};
void fingerflow_prepare_templates(const fingerflow_prepared_templates* given, int threads);

// Templates found in frames: `points` of each of `recordings` are followed through `steps` frames, of which frame k of
// recording b is number k x recordings + b, from place on at speed (P, 2), px and px a frame; both are replaced by those
// after the last frame. Variance one a frame, or null for that of the templates. Results are (steps, P, ...).
struct fingerflow_found_templates {
    fingerflow_frames frames;
    const float *start, *samples, *numbers, *variance;
    float *place, *speed, *found, *error, *covariance;
    unsigned char* status;
    float* estimate;
    std::int64_t recordings, points, steps;
    std::int32_t window, rounds;
    float rounding, forward_backward_limit, mismatch_limit;
};
void fingerflow_find_templates(const fingerflow_found_templates* given, int threads);

// Both at once, of images and as many others with the same strides, points at rest in place: samples are kept nowhere.
void fingerflow_find_pairs(const fingerflow_frames* previous, const void* current, std::int64_t points, float* start,
                           const float* inverse_warp, const float* variance, int window, int gain_offset, int rounds,
                           float* place, float* speed, float rounding, float forward_backward_limit,
                           float mismatch_limit, float* numbers, float* found, float* error, float* covariance,
                           unsigned char* status, float* estimate, int threads);

// Means of 2 x 2 pixels: (batch, height / 2, width / 2), contiguous, as the search takes them.
void fingerflow_halve(const fingerflow_frames* frames, float* halved, int threads);

// Spline coefficients (batch, height, width), contiguous (fingerflow/ops/filters/spline.py).
void fingerflow_spline_coefficients(const fingerflow_frames* frames, float* coefficients, int threads);

// Windows found within `reach` px of a guess by normalised cross-correlation, as fingerflow/ops/tracking/search.py
// describes: images (B, height, width) of half resolution, templates `size` px wide; image index (count), and points,
// guess and found (count, 2) px of full resolution.
struct fingerflow_search {
    const float *templates, *images;
    const std::int64_t* image_index;
    const float *points, *guess;
    float* found;
    std::int64_t height, width, count;
    std::int32_t size, reach;
};
void fingerflow_search_windows(const fingerflow_search* given, int threads);

// The same in images of two kinds of pixels.h, halved first, and the search back from where a window was found: found
// (count, 2), and returns (count) bytes, whether it ends within `limit` px of `start`; guess (count, 2).
struct fingerflow_search_both_ways {
    const void *key, *current;
    const std::int64_t* image_index;
    const float *start, *guess;
    float* found;
    unsigned char* returns;
    std::int64_t key_stride, key_row_stride, key_kind, current_stride, current_row_stride, current_kind;
    std::int64_t batch, height, width, count;
    std::int32_t size, reach;
    float limit;
};
void fingerflow_search_and_return(const fingerflow_search_both_ways* given, int threads);

// Deformed windows of images, at least 4 x 4, by cubic convolution (fingerflow/ops/tracking/window_correlation.py): image
// index (windows), places (windows, 2), warp (windows, 2, 2); found (windows, side, side) at steps from -reach to reach.
struct fingerflow_sampled_windows {
    fingerflow_frames images;
    const std::int64_t* image_index;
    const float *places, *warp;
    float* found;
    std::int64_t windows;
    std::int32_t reach, step;
};
void fingerflow_sample_windows(const fingerflow_sampled_windows* given, int threads);

// One round of the fit of shifts (windows, 2) px of windows, as fingerflow/tracker/window_match.py describes: `now` are windows at the shifts so far, `around` (4,
// windows, samples) those half a pixel to the right, left, below and above of none; weights (windows, samples) are those of
// the round before, and replaced. Deviations and shares excluded (windows).
struct fingerflow_window_shifts {
    const float *then, *now, *around;
    double *shift, *weight, *deviations, *excluded;
    std::int64_t windows;
    std::int32_t samples;
    double noise;
};
void fingerflow_shift_windows(const fingerflow_window_shifts* given, int threads);

// Mean absolute response (batch) of the noise mask, of frames of at least 3 x 3; NaN where no response is finite.
void fingerflow_mean_response(const fingerflow_frames* frames, double* means, int threads);

// Frames and the light of the empty glass behind them (height, width), with the counts without light: one image, or as
// many as frames.
struct fingerflow_lit_frames {
    fingerflow_frames frames;
    const float *light, *black;
    std::int64_t lights, blacks;
};

// Where most of a window of up to 15 x 15 lies below black + limit * light, and the pixel is lit
// (fingerflow/ops/contact/real_contact_mask.py); limits (batch), `real_contact_mask` is contiguous.
void fingerflow_real_contact_mask(const fingerflow_lit_frames* given, const float* limits, int size,
                                  unsigned char* real_contact_mask, int threads);

// Brightness of the lamp in each frame (fingerflow/ops/contact/illumination_gain.py), from blocks of `side` px, a multiple of 8.
void fingerflow_illumination_gain(const fingerflow_lit_frames* given, std::int64_t side, float* gains, int threads);

// Contact of frames in one call, as fingerflow/graphs/contact_graph.py has it: the gains (batch) of the light from blocks of
// `block` px; the mask below limits (batch) times these, or times 1 where a gain is not finite; and the region that it
// spans with `radius` on cells of `side` px. Each as its own function here has it.
void fingerflow_contact_of_frames(const fingerflow_lit_frames* given, const float* limits, int size, std::int64_t block,
                                  std::int64_t radius, std::int64_t side, float* gains, unsigned char* real_contact_mask,
                                  float* density_margin, float* numbers, int threads);

// Relative intensity losses (batch) at the edges of ridges in contact (fingerflow/ops/contact/contact_threshold.py),
// with gains (batch), medians of `size` x `size` px by the `table` of `fingerflow_median`, regions of `radius` on cells of
// `side` px, and every `stride`-th line read.
void fingerflow_contact_threshold(const fingerflow_lit_frames* given, const float* gains, int size,
                                  const std::uint16_t* table, std::int64_t radius, std::int64_t side, std::int64_t stride,
                                  float* thresholds, int threads);

// Light over that of the empty glass, (frame - black) / light, and where it is known
// (fingerflow/ops/filters/illumination.py): where the light exceeds `least`, one number an image of it, and all is finite;
// elsewhere 1. Contiguous.
void fingerflow_normalize(const fingerflow_lit_frames* given, const float* least, float* quotients,
                          unsigned char* known, int threads);

// Counts (batch, count) of uint8 or uint16 frames. `bins` holds the bin of every level, or is null where a level is its
// own bin; `mask` (bytes, one image or one a frame, or null) tells which pixels count.
void fingerflow_histogram(const fingerflow_frames* frames, const unsigned char* mask, std::int64_t masks,
                          std::int64_t mask_stride, std::int64_t mask_row_stride, const std::uint16_t* bins,
                          std::int64_t count, std::int64_t* counts, int threads);

// The regions that contiguous masks of bytes span on cells of `side` 1, 2, 4 or 8 px, as
// fingerflow/ops/contact/apparent_contact.py has them: density_margin (batch, cells down, cells across); numbers
// (batch, 7): pixels covered, area, centre x and y, semi axes, angle.
struct fingerflow_apparent_contacts {
    const unsigned char* masks;
    float *density_margin, *numbers;
    std::int64_t batch, height, width, radius, side;
};
void fingerflow_apparent_contact(const fingerflow_apparent_contacts* given, int threads);

// Whether (batch, count) regions of density margins (batch, cells down, cells across) on cells of `side` px cover points
// (batch, count, 2), each by the rows of `transform` (2, 3) times x, y and 1 (fingerflow/ops/contact/cells.py).
void fingerflow_covered(const float* density_margin, std::int64_t batch, std::int64_t down, std::int64_t across,
                        std::int64_t side, const float* points, std::int64_t count, const float* transform,
                        unsigned char* covered);

// Means of frames over blocks (batch, rows, columns), and over lines (batch, lines that are read), as
// fingerflow/tracker/block_means.py has them: of one pixel of `along` of each line, and one line of `down`.
void fingerflow_block_means(const fingerflow_frames* frames, std::int64_t down, std::int64_t along, std::int64_t rows,
                            std::int64_t columns, float* blocks, float* lines, int threads);

// Mean absolute differences of pairs of sampled frames (pairs, lines, pixels), contiguous, each difference limited to `most`:
// those of `bands` bands of lines and of all, (pairs, bands + 1) (fingerflow/tracker/frame_distances.py).
void fingerflow_frame_distances(const float* now, const float* before, std::int64_t pairs, std::int64_t lines,
                                std::int64_t pixels, std::int64_t bands, float most, float* distances, int threads);

// Weighted linear fits around queries, as fingerflow/ops/fields/local_fit.py has them: arrays of float, or of double where
// `wide` is 1, all contiguous. A batch is that of the results, or 1. Noise (or null) has 1 or components^2 numbers a point.
struct fingerflow_local_fit {
    const void *points, *values, *queries, *noise;
    std::int64_t points_batch, values_batch, queries_batch, noise_batch;
    std::int64_t batch, point_count, query_count, components, noises, minimum_points;
    void *value, *gradient, *covariance, *offset;  // covariance null without noise
    std::int64_t* counts;
};
void fingerflow_local_gradients(const fingerflow_local_fit* given, double radius, double least_spread, int wide,
                                int threads);

// Positions of points corrected for the deformation of the skin, as fingerflow/ops/tracking/deformation.py has it: start (points, 2),
// found (frames, points, 2), covariance (frames, points, 2, 2), numbers (points, 32), inverse_warp (points, 2, 2). Results are
// corrected, remaining (covariance) and warp of those shapes, shift (frames, points) and expected (frames, points, 2).
struct fingerflow_deformation {
    const float *start, *found, *covariance, *numbers, *inverse_warp;
    float *corrected, *remaining, *warp, *shift, *expected;
    std::int64_t frames, points, window, minimum_points;
    double radius, least_spread;
};
void fingerflow_correct_points(const fingerflow_deformation* given, int threads);

// Points off their neighbours, or far more uncertain than they, as fingerflow/ops/tracking/outliers.py has it: numbers of the
// neighbours (neighbours, stride), their offsets x and y, and whether they count, 1 or 0; stride is a multiple of 16 and at
// least `points`, with zeros behind them. Displacement (frames, points, 2), deviation (frames, points); results (frames,
// points) bytes.
struct fingerflow_outliers {
    const std::int32_t* number;
    const float *x, *y, *within, *displacement, *deviation;
    unsigned char *off_neighbours, *uncertain;
    std::int64_t frames, points, stride, neighbours;
    float spread, ridge, least_deviation, most_disagreement, most_uncertainty;
    std::int32_t least_neighbours;
};
void fingerflow_find_outliers(const fingerflow_outliers* given, int threads);

// Points worth tracking in a frame, at least 7 x 7, and a mask of bytes, as fingerflow/graphs/detect.py has them: up to
// `count` points (count, 2), strongest first, and their responses, NaN behind the last. None lies nearer than `border` to
// the edge, and each is the strongest in a square that reaches `beside` px; squares that reach `farthest` px are the
// largest that are compared. Responses exceed `quality` times the strongest, and `noise` times the variance of the frame's
// noise.
struct fingerflow_detection {
    fingerflow_frames frame;
    const unsigned char* mask;
    float *points, *responses;
    std::int64_t mask_row_stride, border, beside, farthest, count;
    float quality, noise;
};
void fingerflow_detect_points(const fingerflow_detection* given, int threads);

// Medians (batch, 5) over ellipses of divergence, curl, exx, eyy and exy, as fingerflow/ops/fields/area_medians.py has them, and
// their standard deviations where there are covariances, and the shares (batch) of positions where they are known: reference (1 or batch, point_count, 2), displacement (batch,
// point_count, 2), covariance (batch, point_count, 2, 2) or null, ellipses (batch, 6) with centre, semi axes, cosine and
// sine, lattice (positions, 2) in the unit disc. Measure 0 is Green-Lagrange, 1 as printed, 2 infinitesimal. `apart`
// (batch, point_count) bytes, or null, tells points with fields (batch, point_count, 5) of their own, NaN where they are
// not known, and their deviations where there are covariances; positions that such a point is nearest to have them
// within `same_place` radii.
struct fingerflow_area_medians {
    const float *reference, *displacement, *ellipses, *covariance, *lattice;
    const unsigned char* apart;
    const float *apart_fields, *apart_deviations;
    float *medians, *deviations, *shares;
    std::int64_t batch, reference_batch, point_count, positions, measure, minimum_points;
    double radius, least_spread, farthest, least_ratio, least_share, reach, even, same_place;
};
void fingerflow_medians_over_area(const fingerflow_area_medians* given, int threads);

// Strain of triangles and its energy, as fingerflow/ops/fields/triangle_strain.py has them: displacement (batch, point_count, 2),
// covariance (batch, point_count, 2, 2), in_contact (batch, triangle_count) bytes; of the triangles corners (3, .), slopes
// (2, 3, .) by x and y, their products xx, xy, yy with those of the errors that a corner shares (3, 3, .), areas and
// whether they are flat, NaN or 0. Measure as above; direct, between and shear are the
// factors of exx^2 + eyy^2, exx eyy and exy^2 in the energy. Results (batch, triangle_count, ...), energy (batch),
// forces (batch, point_count, 2), and the sum (batch) of the squares of what each point's error adds to the energy.
struct fingerflow_triangle_strain {
    const float *displacement, *covariance;
    const unsigned char* in_contact;
    const std::int32_t* corners;
    const float *slopes, *products, *areas, *flat;
    float *strain, *strain_std, *density;
    double* energy;
    float* forces;
    double* own;
    std::int64_t batch, point_count, triangle_count, measure;
    double direct, between, shear;
};
void fingerflow_strain_of_triangles(const fingerflow_triangle_strain* given, int threads);

// A flow led down to its fixed point, as fingerflow/ops/flow/flow_multigrid.py does it: levels from the finest on, their planes those
// of all images of the batch; pull, flow and moved (batch, 2, height, width) of the finest, known (batch, height, width).
// Weights of a window: the middle one and `half` more.
struct fingerflow_flow_level {
    float *tensor, *right, *down, *inverse, *inside;
    std::int64_t height, width;
};
struct fingerflow_flow_descend_of {
    const fingerflow_flow_level* levels;
    const float *pull, *flow, *known, *weights;
    float* moved;
    std::int64_t count, batch, half;
    std::int32_t cycles, sweeps, coarsest;
    float damping;
};
void fingerflow_flow_descend(const fingerflow_flow_descend_of* given, int threads);

// What dense flow takes from the first image, as `_fields` of fingerflow/ops/flow/dense_flow.py has it: of images (batch, height, width)
// coefficients and mask, value, gradient (batch, 2, height, width), inside; of their cells tensor (batch, 3, ...), known and
// the edges to the next of the row (one column less) and of the column (one row less), for alpha 1.
struct fingerflow_flow_template_of {
    const float *coefficients, *mask;
    float *value, *gradient, *inside, *tensor, *known, *right, *down;
    std::int64_t batch, height, width, margin;
};
void fingerflow_flow_template(const fingerflow_flow_template_of* given, int threads);

// What a flow on cells leaves unexplained, as `_data` of fingerflow/ops/flow/dense_flow.py has it: of images (batch, height, width)
// coefficients, value, gradient (batch, 2, height, width), inside; of their cells of 2 x 2 flow and data (batch, 2, ...), known,
// squares and seen; gain (batch).
struct fingerflow_flow_left_of {
    const float *coefficients, *value, *gradient, *inside, *flow, *known;
    float *data, *squares, *seen, *gain;
    std::int64_t batch, height, width;
    float margin, most_gain;
};
void fingerflow_flow_left(const fingerflow_flow_left_of* given, int threads);
