// Structures of arguments, and functions that sources of this folder call; a function that only Python calls is declared by
// its definition. The entries that Python calls are written from both (generate_entries.py), and the library has their text,
// by which Python checks arguments and allocates results (fingerflow/kernels/declarations.py).
// Arguments go by name, those of a structure among the others, so a name stands once in a function.
// What a function throws becomes an exception of Python's.
//
// A comment behind an address declares the array: its shape, whose names are arguments (whole numbers, which Python takes
// from the shapes) or only names; `a|b` is 1 or b, known as a. Before the shape stands the dtype where C++ does not tell it
// (several, or that of another array); behind it `optional` (null where Python has None), `rows` (pixels of a row are
// contiguous, with strides in pixels <name>_stride and <name>_row_stride), `updated` (a copy of it is written and returned; zeros for None),
// `below n` (values lie from 0 to n - 1). An address that is not const is a result, `if x` one that x asks for.
// A comment behind a number limits it: `from a to b`, `by c` (in steps of c from a on), `among a b c`,
// `where` what must hold. An int <name>_kind is the dtype of an array among those that it may have.
#pragma once

#include <cstdint>

// Frames (batch, height, width) of a kind of pixels.h; the pixels of a row are contiguous.
struct fingerflow_frames {
    const void* data;
    std::int64_t batch, height, width, frame_stride, row_stride, kind;
};

// Medians of size x size windows of uint8 or uint16 frames; `medians` is contiguous. `table` is null for a compiled size,
// else what fingerflow/kernels/median_rows.py writes for it.
void fingerflow_median(const fingerflow_frames* frames /* uint8 uint16 */, void* medians /* frames (batch, 1, height, width) */,
                       int size /* from 3 to 31 by 2 */, const std::uint16_t* table /* (entries) optional */, int threads);

// Templates of `points` of each image prepared, as fingerflow/ops/tracking/templates.py describes; all contiguous. Of P =
// images x points: start (P, 2), NaN is written where there is no point; inverse_warp (P, 2, 2) or null, samples
// (P, 3, window, window), numbers (P, 32); variance one an image.
struct fingerflow_prepared_templates {
    fingerflow_frames image /* 4 x 4 */;
    float* start /* (batch, points, 2) updated */;
    const float *inverse_warp /* (batch, points, 2, 2) optional */, *variance /* (batch) */;
    float *samples /* (batch, points, 3, window * window) */, *numbers /* (batch, points, 32) */;
    std::int64_t points;
    std::int32_t window /* from 5 to 4095 by 2 */, gain_offset;
    float rounding;
};

// Templates found in frames: `points` of each of `recordings` are followed through `steps` frames, of which frame k of
// recording b is number k x recordings + b, from place on at speed (P, 2), px and px a frame; both are replaced by those
// after the last frame. Variance one a frame, or null for that of the templates. Results are (steps, P, ...).
struct fingerflow_found_templates {
    fingerflow_frames frames /* 4 x 4 */;
    const float *start /* (recordings, points, 2) */, *samples /* (recordings, points, 3, window * window) */,
        *numbers /* (recordings, points, 32) */, *variance /* (batch) optional */;
    float *place /* (recordings, points, 2) updated */, *speed /* (recordings, points, 2) updated optional */,
        *found /* (steps, recordings, points, 2) */, *error /* (steps, recordings, points) */,
        *covariance /* (steps, recordings, points, 2, 2) */;
    unsigned char* status /* (steps, recordings, points) */;
    float* estimate /* (steps, recordings, points, 2) */;
    std::int64_t recordings, points, steps /* where batch == steps * recordings */;
    std::int32_t window /* from 5 to 4095 by 2 */, rounds;
    float rounding, forward_backward_limit, mismatch_limit;
};

// Means of 2 x 2 pixels: (batch, height / 2, width / 2), contiguous, as the search takes them.
void fingerflow_halve(const fingerflow_frames* frames /* 3 x 3 */, float* halved /* (batch, 1, height / 2, width / 2) */,
                      int threads);

// Windows found within `reach` px of a guess by normalised cross-correlation, as fingerflow/ops/tracking/search.py
// describes: images (B, height, width) of half resolution, templates `size` px wide; image index (count), and points,
// guess and found (count, 2) px of full resolution.
struct fingerflow_search {
    const float *templates /* (batch, 1, height, width) */, *images /* (batch, 1, height, width) */;
    const std::int64_t* image_index /* (count) below batch */;
    const float *points /* (count, 2) */, *guess /* (count, 2) */;
    float* found /* (count, 2) */;
    std::int64_t height, width, count;
    std::int32_t size /* from 1 to 32768 by 2 */, reach;
};
void fingerflow_search_windows(const fingerflow_search* given, int threads);

// The same in images of two kinds of pixels.h, halved first, and the search back from where a window was found: found
// (count, 2), and returns (count) bytes, whether it ends within `limit` px of `start`; guess (count, 2).
struct fingerflow_search_both_ways {
    const void *key /* uint8 uint16 int32 float32 (batch, 1, height, width) rows */,
        *current /* uint8 uint16 int32 float32 (batch, 1, height, width) rows */;
    const std::int64_t* image_index /* (count) below batch */;
    const float *start /* (count, 2) */, *guess /* (count, 2) */;
    float* found /* (count, 2) */;
    unsigned char* returns /* bool (count) */;
    std::int64_t key_stride, key_row_stride, key_kind, current_stride, current_row_stride, current_kind;
    std::int64_t batch, height /* from 3 */, width /* from 3 */, count;
    std::int32_t size /* from 1 to 32768 by 2 */, reach;
    float limit;
};

// Deformed windows of images, at least 4 x 4, by cubic convolution (fingerflow/ops/tracking/window_correlation.py): image
// index (windows), places (windows, 2), warp (windows, 2, 2); found (windows, side, side) at steps from -reach to reach.
struct fingerflow_sampled_windows {
    fingerflow_frames images /* 4 x 4 */;
    const std::int64_t* image_index /* (windows) below batch */;
    const float *places /* (windows, 2) */, *warp /* (windows, 2, 2) */;
    float* found /* (windows, (2 * reach / step + 1) ** 2) */;
    std::int64_t windows;
    std::int32_t reach /* to 2047 */, step /* from 1 */;
};

// One round of the fit of shifts (windows, 2) px of windows, as fingerflow/tracker/window_match.py describes: `now` are windows at the shifts so far, `around` (4,
// windows, samples) those half a pixel to the right, left, below and above of none; weights (windows, samples) are those of
// the round before, and replaced. Lengths of the shifts and largest residuals (windows)
// in standard deviations.
struct fingerflow_window_shifts {
    const float *then /* (windows, samples) */, *now /* (windows, samples) */, *around /* (4, windows, samples) */;
    double *shift /* (windows, 2) updated */, *weight /* (windows, samples) updated */, *deviations /* (windows) */,
        *largest /* (windows) */;
    std::int64_t windows;
    std::int32_t samples /* from 1 */;
    double noise;
};

// Mean absolute response (batch) of the noise mask, of frames of at least 3 x 3; NaN where no response is finite.
void fingerflow_mean_response(const fingerflow_frames* frames /* 3 x 3 */, double* means /* (batch) */, int threads);

// Frames and the light of the empty glass behind them (height, width), with the counts without light: one image, or as
// many as frames.
struct fingerflow_lit_frames {
    fingerflow_frames frames;
    const float *light /* (lights|batch, 1, height, width) */, *black /* (blacks|batch, 1, height, width) */;
    std::int64_t lights, blacks;
};

// Where most of a window of up to 15 x 15 lies below black + limit * light, and the pixel is lit
// (fingerflow/ops/contact/real_contact_mask.py); limits (batch), `real_contact_mask` is contiguous.
void fingerflow_real_contact_mask(const fingerflow_lit_frames* given, const float* limits /* (batch) */,
                                  int size /* from 1 to 15 by 2 */,
                                  unsigned char* real_contact_mask /* bool (batch, 1, height, width) */, int threads);

// Brightness of the lamp in each frame (fingerflow/ops/contact/illumination_gain.py), from blocks of `side` px, a multiple of 8.
void fingerflow_illumination_gain(const fingerflow_lit_frames* given, std::int64_t side /* from 8 by 8 */,
                                  float* gains /* (batch) */, int threads);

// Counts (batch, count) of uint8 or uint16 frames. `bins` holds the bin of every level, or is null where a level is its
// own bin; `mask` (bytes, one image or one a frame, or null) tells which pixels count.
void fingerflow_histogram(const fingerflow_frames* frames /* uint8 uint16 */,
                          const unsigned char* mask /* bool (masks|batch, 1, height, width) rows optional */,
                          std::int64_t masks, std::int64_t mask_stride, std::int64_t mask_row_stride,
                          const std::uint16_t* bins /* (levels) below count optional */,
                          std::int64_t count /* from 1 to 65536 where (levels or count) >= 256 ** (frames_kind + 1) */,
                          std::int64_t* counts /* (batch, count) */, int threads);

// The regions that contiguous masks of bytes span on cells of `side` 1, 2, 4 or 8 px, as
// fingerflow/ops/contact/apparent_contact.py has them: density_margin (batch, cells down, cells across); numbers
// (batch, 7): pixels covered, area, centre x and y, semi axes, angle.
struct fingerflow_apparent_contacts {
    const unsigned char* masks /* bool (batch, 1, height, width) */;
    float *density_margin /* (batch, 1, -(-height / side), -(-width / side)) */, *numbers /* (batch, 7) */;
    std::int64_t batch, height, width, radius /* from 1 to 255 */, side /* among 1 2 4 8 where side <= 2 * radius + 1 */;
};
void fingerflow_apparent_contact(const fingerflow_apparent_contacts* given, int threads);

// Weighted linear fits around queries, as fingerflow/ops/fields/local_fit.py has them: arrays of float, or of double where
// `wide` is 1, all contiguous. A batch is that of the results, or 1. Noise (or null) has 1 or components^2 numbers a point.
struct fingerflow_local_fit {
    const void *points /* float32 float64 (points_batch|batch, point_count, 2) */,
        *values /* points (values_batch|batch, point_count, components) */,
        *queries /* points (queries_batch|batch, query_count, 2) */,
        *noise /* points (noise_batch|batch, point_count, noises|components ** 2) optional */;
    std::int64_t points_batch, values_batch, queries_batch, noise_batch;
    std::int64_t batch, point_count, query_count, components, noises, minimum_points;
    void *value /* points (batch, query_count, components) */, *gradient /* points (batch, query_count, components, 2) */,
        *covariance /* points (batch, query_count, components, 2, components, 2) if noise */;
    std::int64_t* counts /* (batch, query_count) */;
    void* offset /* points (batch, query_count) */;
};
void fingerflow_local_gradients(const fingerflow_local_fit* given, double radius, double least_spread, int points_kind,
                                int threads);

// Positions of points corrected for the deformation of the skin, as fingerflow/ops/tracking/deformation.py has it: start (points, 2),
// found (frames, points, 2), covariance (frames, points, 2, 2), numbers (points, 32), inverse_warp (points, 2, 2). Results are
// corrected, remaining (covariance) and warp of those shapes, shift (frames, points) and expected (frames, points, 2).
struct fingerflow_deformation {
    const float *start /* (points, 2) */, *found /* (frames, points, 2) */, *covariance /* (frames, points, 2, 2) */,
        *numbers /* (points, 32) */, *inverse_warp /* (points, 2, 2) */;
    float *corrected /* (frames, points, 2) */, *remaining /* (frames, points, 2, 2) */, *warp /* (frames, points, 2, 2) */,
        *shift /* (frames, points) */, *expected /* (frames, points, 2) */;
    std::int64_t frames, points, window /* from 3 */, minimum_points;
    double radius, least_spread;
};

// Points off their neighbours, or far more uncertain than they, as fingerflow/ops/tracking/outliers.py has it: numbers of the
// neighbours (neighbours, stride), their offsets x and y, and whether they count, 1 or 0; stride is a multiple of 16 and at
// least `points`, with zeros behind them. Displacement (frames, points, 2), deviation (frames, points); results (frames,
// points) bytes.
struct fingerflow_outliers {
    const std::int32_t* number /* (neighbours, stride) below points */;
    const float *x /* (neighbours, stride) */, *y /* (neighbours, stride) */, *within /* (neighbours, stride) */,
        *displacement /* (frames, points, 2) */, *deviation /* (frames, points) */;
    unsigned char *off_neighbours /* bool (frames, points) */, *uncertain /* bool (frames, points) */;
    std::int64_t frames, points, stride /* where stride >= points and stride % 16 == 0 */, neighbours;
    float spread, ridge, least_deviation, most_disagreement, most_uncertainty;
    std::int32_t least_neighbours;
};

// Points worth tracking in a frame, at least 7 x 7, and a mask of bytes, as fingerflow/graphs/detect.py has them: up to
// `count` points (count, 2), strongest first, and their responses, NaN behind the last. None lies nearer than `border` to
// the edge, and each is the strongest in a square that reaches `beside` px; squares that reach `farthest` px are the
// largest that are compared. Responses exceed `quality` times the strongest, and `noise` times the variance of the frame's
// noise.
struct fingerflow_detection {
    fingerflow_frames frame /* 7 x 7 */;
    const unsigned char* mask /* bool (batch, 1, height, width) rows */;
    float *points /* (count, 2) */, *responses /* (count) */;
    std::int64_t mask_row_stride, border /* from 3 */, beside /* from 1 */, farthest, count /* from 1 where batch == 1 */;
    float quality, noise;
};

// Medians (batch, 5) over ellipses of divergence, curl, exx, eyy and exy, as fingerflow/ops/fields/area_medians.py has them, and
// their standard deviations where there are covariances, and the shares (batch) of positions where they are known: reference (1 or batch, point_count, 2), displacement (batch,
// point_count, 2), covariance (batch, point_count, 2, 2) or null, ellipses (batch, 6) with centre, semi axes, cosine and
// sine, lattice (positions, 2) in the unit disc. Measure 0 is Green-Lagrange, 1 as printed, 2 infinitesimal. `apart`
// (batch, point_count) bytes, or null, tells points with fields (batch, point_count, 5) of their own, NaN where they are
// not known, and their deviations where there are covariances; positions that such a point is nearest to have them
// within `same_place` radii.
struct fingerflow_area_medians {
    const float *reference /* (reference_batch|batch, point_count, 2) */, *displacement /* (batch, point_count, 2) */,
        *ellipses /* (batch, 6) */, *covariance /* (batch, point_count, 2, 2) optional */, *lattice /* (positions, 2) */;
    const unsigned char* apart /* bool (batch, point_count) optional */;
    const float *apart_fields /* (batch, point_count, 5) optional */, *apart_deviations /* (batch, point_count, 5) optional */;
    float *medians /* (batch, 5) */, *deviations /* (batch, 5) if covariance */, *shares /* (batch) */;
    std::int64_t batch, reference_batch, point_count, positions, measure /* to 2 */, minimum_points;
    double radius, least_spread, farthest, least_ratio, least_share, reach, even, same_place;
};
void fingerflow_medians_over_area(const fingerflow_area_medians* given, int threads);

// Fields at points in frames and their medians over ellipses (centre, semi_axes, angle) of sharpened displacements, as
// fingerflow/graphs/fields_graph.py has them: reference (point_count, 2), displacement and its covariance, or null, by
// frame. `apart` tells points with gradients of their own, ux, uy, vx, vy, and their covariances. Results are those of
// each point, and those of fingerflow_area_medians.
struct fingerflow_frame_fields {
    const float *reference /* (point_count, 2) */, *displacement /* (batch, point_count, 2) */,
        *covariance /* (batch, point_count, 2, 2) optional */, *center /* (batch, 2) */, *semi_axes /* (batch, 2) */,
        *angle /* (batch) */, *lattice /* (positions, 2) */;
    const unsigned char* apart /* bool (batch, point_count) optional */;
    const float *apart_gradient /* (batch, point_count, 2, 2) optional */,
        *apart_covariance /* (batch, point_count, 2, 2, 2, 2) optional */;
    float *divergence /* (batch, point_count) */, *curl /* (batch, point_count) */, *strain /* (batch, point_count, 3) */,
        *shear /* (batch, point_count, 2) */, *divergence_std /* (batch, point_count) if covariance */,
        *curl_std /* (batch, point_count) if covariance */, *medians /* (batch, 5) */,
        *deviations /* (batch, 5) if covariance */, *shares /* (batch) */;
    std::int64_t batch, point_count, positions, measure /* to 2 */, minimum_points;
    double radius, least_spread, farthest, least_ratio, least_share, reach, even, same_place;
    float sharpened, sharpened_noise;
};

// Strain of triangles and its energy, as fingerflow/ops/fields/triangle_strain.py has them: displacement (batch, point_count, 2),
// covariance (batch, point_count, 2, 2), in_contact (batch, triangle_count) bytes; of the triangles corners (3, .), slopes
// (2, 3, .) by x and y, their products xx, xy, yy with those of the errors that a corner shares (3, 3, .), areas and
// whether they are flat, NaN or 0. Measure as above; direct, between and shear are the
// factors of exx^2 + eyy^2, exx eyy and exy^2 in the energy. Results (batch, triangle_count, ...), energy (batch),
// forces (batch, point_count, 2), and the sum (batch) of the squares of what each point's error adds to the energy.
struct fingerflow_triangle_strain {
    const float *displacement /* (batch, point_count, 2) */, *covariance /* (batch, point_count, 2, 2) */;
    const unsigned char* in_contact /* bool (batch, triangle_count) */;
    const std::int32_t* corners /* (3, triangle_count) below point_count */;
    const float *slopes /* (2, 3, triangle_count) */, *products /* (3, 3, triangle_count) */, *areas /* (triangle_count) */,
        *flat /* (triangle_count) */;
    float *strain /* (batch, triangle_count, 3) */, *strain_std /* (batch, triangle_count, 3) */,
        *density /* (batch, triangle_count) */;
    double* energy /* (batch) */;
    float* forces /* (batch, point_count, 2) */;
    double* own /* (batch) */;
    std::int64_t batch, point_count, triangle_count, measure /* to 2 */;
    double direct, between, shear;
};

// A flow led down to its fixed point, as fingerflow/ops/flow/flow_multigrid.py does it: levels from the finest on, their planes those
// of all images of the batch; pull, flow and moved (batch, 2, height, width) of the finest, known (batch, height, width).
// Weights of a window: the middle one and `half` more.
struct fingerflow_flow_level {
    float *tensor, *right, *down, *inverse, *inside;
    std::int64_t height, width;
};
struct fingerflow_flow_descend_of {
    const fingerflow_flow_level* levels /* int64 (count, 7) */;
    const float *pull /* (batch, 2, height, width) */, *flow /* (batch, 2, height, width) */,
        *known /* (batch, 1, height, width) */, *weights /* (half + 1) */;
    float* moved /* (batch, 2, height, width) */;
    std::int64_t count /* from 1 */, batch, half;
    std::int32_t cycles, sweeps, coarsest;
    float damping;
};

// What dense flow takes from the first image, as `_fields` of fingerflow/ops/flow/dense_flow.py has it: of images (batch, height, width)
// coefficients and mask, value, gradient (batch, 2, height, width), inside; of their cells tensor (batch, 3, ...), known and
// the edges to the next of the row (one column less) and of the column (one row less), for alpha 1.
struct fingerflow_flow_template_of {
    const float *coefficients /* (batch, 1, height, width) */, *mask /* (batch, 1, height, width) */;
    float *value /* (batch, 1, height, width) */, *gradient /* (batch, 2, height, width) */,
        *inside /* (batch, 1, height, width) */, *tensor /* (batch, 3, (height + 1) / 2, (width + 1) / 2) */,
        *known /* (batch, 1, (height + 1) / 2, (width + 1) / 2) */,
        *right /* (batch, 1, (height + 1) / 2, (width + 1) / 2 - 1) */,
        *down /* (batch, 1, (height + 1) / 2 - 1, (width + 1) / 2) */;
    std::int64_t batch, height, width, margin;
};

// What a flow on cells leaves unexplained, as `_data` of fingerflow/ops/flow/dense_flow.py has it: of images (batch, height, width)
// coefficients, value, gradient (batch, 2, height, width), inside; of their cells of 2 x 2 flow and data (batch, 2, ...), known,
// squares and seen; gain (batch).
struct fingerflow_flow_left_of {
    const float *coefficients /* (batch, 1, height, width) */, *value /* (batch, 1, height, width) */,
        *gradient /* (batch, 2, height, width) */, *inside /* (batch, 1, height, width) */,
        *flow /* (batch, 2, (height + 1) / 2, (width + 1) / 2) */, *known /* (batch, 1, (height + 1) / 2, (width + 1) / 2) */;
    float *data /* (batch, 2, (height + 1) / 2, (width + 1) / 2) */, *squares /* (batch, 1, (height + 1) / 2, (width + 1) / 2) */,
        *seen /* (batch, 1, (height + 1) / 2, (width + 1) / 2) */, *gain /* (batch, 1, 1, 1) */;
    std::int64_t batch, height, width;
    float margin, most_gain;
};
