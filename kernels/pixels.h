// Number types of pixels, as coded by fingerflow/kernels.
#pragma once

#include "interface.h"

namespace fingerflow {

enum PixelKind : std::int64_t { kUint8 = 0, kUint16 = 1, kInt32 = 2, kFloat32 = 3 };

using Frames = fingerflow_frames;

// Returns function(pointer of the type `kind`).
#define FINGERFLOW_FOR_PIXEL(kind, data, function)                                             \
    switch (kind) {                                                                            \
        case fingerflow::kUint8: return function(static_cast<const std::uint8_t*>(data));      \
        case fingerflow::kUint16: return function(static_cast<const std::uint16_t*>(data));    \
        case fingerflow::kInt32: return function(static_cast<const std::int32_t*>(data));      \
        default: return function(static_cast<const float*>(data));                             \
    }

}  // namespace fingerflow
