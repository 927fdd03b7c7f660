// Contact of frames in one call: illumination gain, real-contact mask and apparent-contact region, one after the other
// (fingerflow/graphs/contact_graph.py). The mask's limit is limits[frame] * gain, clamped to [0, 1], with gain 1 where
// unknown.
// Layout: gains (batch), masks and density margins contiguous, as the three functions called here write them.
#include <cmath>
#include <vector>

#include "interface.h"

// Contact of frames in one call, as fingerflow/graphs/contact_graph.py has it: the gains (batch) of the light from blocks of
void fingerflow_contact_of_frames(const fingerflow_lit_frames* given, const float* limits /* (batch) */, int size /* from 1 to 15 by 2 */,
    std::int64_t block /* from 8 by 8 */, std::int64_t radius /* from 1 to 255 */, std::int64_t side /* among 1 2 4 8 where side <= 2 * radius + 1 */,
    unsigned char* real_contact_mask /* bool (batch, 1, height, width) */, float* density_margin /* (batch, 1, -(-height / side), -(-width / side)) */,
    float* numbers /* (batch, 7) */, float* gains /* (batch) */, int threads) {
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
