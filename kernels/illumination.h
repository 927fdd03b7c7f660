// What the kernels that start from frames share: their images, and the least light at which a quotient means anything.
#pragma once

#include <vector>

#include "illumination_rows.h"
#include "interface.h"

namespace fingerflow {

Illumination illumination_of(const fingerflow_images& images, float minimum, float low, float levels_per_unit);

// One number for each image of light, which may be one for all frames.
std::vector<float> least_lights(const Illumination& given, int threads);

}  // namespace fingerflow
