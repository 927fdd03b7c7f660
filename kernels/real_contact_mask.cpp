// Real-contact mask: a lit pixel touches where most of a size x size window lies below black + limit * light
// (fingerflow/ops/contact/real_contact_mask.py).
// Layout: results are bytes, contiguous (batch, height, width). A piece is some rows of all frames, so that the light
// of the empty glass is read once for all of them.
#include "interface.h"

#include <algorithm>

#include "parallel.h"
#include "real_contact_mask_rows.h"
#include "workspace.h"

void fingerflow_real_contact_mask(const fingerflow_lit_frames* given, const float* limits, int size, unsigned char* real_contact_mask,
                         int threads) {
    using namespace fingerflow;
    const std::int64_t batch = given->batch, height = given->height, width = given->width;
    if (batch * height * width == 0) return;
    const fingerflow_image& image = given->frames;
    const Frames frames{image.data, batch, height, width, image.image_stride, image.row_stride, static_cast<PixelKind>(image.kind)};
    const Lit lit{given->light, given->black, given->lights, given->blacks};
    const std::int64_t shared = (height + threads - 1) / threads, rows = std::min<std::int64_t>(std::max(64, 4 * size), shared);
    const std::int64_t pieces = (height + rows - 1) / rows;
    const auto find = FINGERFLOW_PICK(real_contact_mask_rows);
    parallel_for(pieces, threads, [&](std::int64_t piece) {
        const std::int64_t top = piece * rows, bottom = std::min(height, top + rows);
        auto* const memory = static_cast<unsigned char*>(workspace(real_contact_mask_memory(frames, size)));
        find(frames, lit, top, bottom, size, limits, memory, real_contact_mask);
    });
}
