// Strain of a displacement gradient (fingerflow/ops/fields/strain.py).
#pragma once

#include <cstdint>

namespace fingerflow {

// Factors of the products of gradients in normal and in shear strain: measure 0 is Green-Lagrange, 1 as printed,
// 2 infinitesimal.
constexpr float squared_factor(std::int64_t measure) { return measure == 2 ? 0.0f : 0.5f; }
constexpr float mixed_factor(std::int64_t measure) { return measure == 0 ? 0.5f : 0.0f; }

namespace FINGERFLOW_ISA {

struct Strain {
    float xx, yy, xy;
};

inline Strain strain_of(float squared, float mixed, float ux, float uy, float vx, float vy) {
    return {ux + squared * (ux * ux + vx * vx), vy + squared * (uy * uy + vy * vy), (uy + vx) / 2 + mixed * (ux * uy + vx * vy)};
}

}  // namespace FINGERFLOW_ISA
}  // namespace fingerflow
