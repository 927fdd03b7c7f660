// Light lost in some rows of one frame.
#pragma once

#include "instruction_sets.h"
#include "pixels.h"

namespace fingerflow {

struct Illumination {
    Frames frames, reference, dark;  // a batch of one serves all frames; dark.data is null for zero
    float minimum, low, levels_per_unit;
};

struct LightLost {
    float* signal;
    unsigned char *levels, *valid;
};

// clang-format off
FINGERFLOW_FOR_EACH_SET(
    // The least light at which a quotient means anything: `minimum` of the 0.99 quantile of every step-th pixel. `values`
    // holds one float for each of them, and 31 more.
    float least_light(const Illumination& given, std::int64_t frame, std::int64_t step, float* lines, float* values);
    // Results begin with row `top`; signal and levels may be null. `lines` holds 6 x width floats.
    void light_lost_rows(const Illumination& given, std::int64_t frame, std::int64_t top, std::int64_t bottom, float least,
                         float* lines, const LightLost& lost);
)
// clang-format on

}  // namespace fingerflow
