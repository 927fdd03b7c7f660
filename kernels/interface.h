// What fingerflow/kernels.py calls. Plain C, so that one library serves every Python, without its headers and without
// its lock. Shapes, strides and dtypes are checked there. Strides are in pixels. A function returns 0, or 1 when the
// system had no memory or no thread to give.
#pragma once

#include <cstdint>

#ifdef _WIN32
#define FINGERFLOW_EXPORT extern "C" __declspec(dllexport)
#else
#define FINGERFLOW_EXPORT extern "C" __attribute__((visibility("default")))
#endif

// Changes with every signature below.
FINGERFLOW_EXPORT int fingerflow_interface();

// The widest instruction set in use from now on: 0 for the baseline of the processor's kind, 1 for AVX2, 2 for AVX-512,
// -1 for all that the processor has. Returns the one taken. For tests; every set gives the same answers.
FINGERFLOW_EXPORT int fingerflow_limit_instruction_set(int most);

// Medians of size x size windows of `batch` frames, uint8 or uint16 as `pixel_bytes` says; `medians` is contiguous.
// `table` is null for a compiled size, else what fingerflow/ops/median_rows.py writes for it.
FINGERFLOW_EXPORT int fingerflow_median(const void* frames, void* medians, std::int64_t batch, std::int64_t height,
                                        std::int64_t width, std::int64_t frame_stride, std::int64_t row_stride,
                                        int pixel_bytes, int size, const std::uint16_t* table, int threads);

// Points of one image found in another and back again, as fingerflow/ops/tracking.py describes, with cubic splines.
// Coefficients are (B, height, width), the points of all images flat: image index, noise, error and status (count),
// start, guess, back_guess (or null) and points (count, 2), warp (or null) and covariance (count, 2, 2), all contiguous.
FINGERFLOW_EXPORT int fingerflow_track_points(const float* from, const float* to, std::int64_t height,
                                              std::int64_t width, const std::int64_t* image_index, const float* noise,
                                              const float* start, const float* guess, const float* back_guess,
                                              const float* warp, std::int64_t count, int window, int gain_offset,
                                              float rounding, float forward_backward_limit,
                                              float mismatch_limit, float* points, float* error, float* covariance,
                                              unsigned char* status, int threads);

// Spline coefficients, and the mean absolute response of the noise mask, of `batch` frames of a kind of pixels.h, at
// least 3 x 3; coefficients (batch, height, width) contiguous, means (batch), NaN where no response is finite.
FINGERFLOW_EXPORT int fingerflow_spline_coefficients(const void* frames, float* coefficients, std::int64_t batch,
                                                     std::int64_t height, std::int64_t width, std::int64_t frame_stride,
                                                     std::int64_t row_stride, int kind, int threads);
FINGERFLOW_EXPORT int fingerflow_mean_response(const void* frames, double* means, std::int64_t batch,
                                               std::int64_t height, std::int64_t width, std::int64_t frame_stride,
                                               std::int64_t row_stride, int kind, int threads);
