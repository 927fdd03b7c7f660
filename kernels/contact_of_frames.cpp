// Contact of frames in one call: illumination gain, real-contact mask and apparent-contact region, one after the other
// (fingerflow/graphs/contact_graph.py). The mask's limit is limits[frame] * gain, clamped to [0, 1], with gain 1 where
// unknown.
// Layout: gains (batch), masks and density margins contiguous, as the three functions called here write them.
#include <cmath>
#include <vector>

#include "interface.h"

void fingerflow_contact_of_frames(const fingerflow_lit_frames* given, const float* limits, int size, std::int64_t block,
                                  std::int64_t radius, std::int64_t side, unsigned char* real_contact_mask,
                                  float* density_margin, float* numbers, float* gains, int threads) {
    fingerflow_illumination_gain(given, block, gains, threads);
    std::vector<float> shares(static_cast<std::size_t>(given->frames.batch));
    for (std::size_t frame = 0; frame < shares.size(); ++frame) {
        const float share = limits[frame] * (std::isfinite(gains[frame]) ? gains[frame] : 1.0f);
        // Limits lie within [0, 1]; below that of an unknown one there is no pixel.
        shares[frame] = std::isnan(share) ? -INFINITY : share > 0 ? (share < 1 ? share : 1.0f) : 0.0f;
    }
    fingerflow_real_contact_mask(given, shares.data(), size, real_contact_mask, threads);
    const fingerflow_apparent_contacts regions{real_contact_mask, density_margin, numbers, given->frames.batch,
                                               given->frames.height, given->frames.width, radius, side};
    fingerflow_apparent_contact(&regions, threads);
}
