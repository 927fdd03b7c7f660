// Contact of frames, one part after the other: light, mask and region.
#include <cmath>
#include <vector>

#include "interface.h"

void fingerflow_contact_of_frames(const fingerflow_lit_frames* given, const float* limits, int size, std::int64_t block,
                                  std::int64_t radius, std::int64_t side, float* gains, unsigned char* real_contact_mask,
                                  float* density_margin, float* numbers, int threads) {
    fingerflow_light_gain(given, block, gains, threads);
    std::vector<float> shares(static_cast<std::size_t>(given->batch));
    for (std::size_t frame = 0; frame < shares.size(); ++frame) {
        const float share = limits[frame] * (std::isfinite(gains[frame]) ? gains[frame] : 1.0f);
        // NaN is undercut nowhere, and no more than all of the light counts.
        shares[frame] = share > 0 ? (share < 1 ? share : 1.0f) : 0.0f;
    }
    fingerflow_real_contact_mask(given, shares.data(), size, real_contact_mask, threads);
    const fingerflow_apparent_contacts regions{real_contact_mask, density_margin, numbers, given->batch, given->height,
                                               given->width, radius, side};
    fingerflow_apparent_contact(&regions, threads);
}
