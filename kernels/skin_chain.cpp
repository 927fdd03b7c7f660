// Skin chains pressed (fingerflow/models/skin_implicit.py). The equations are in skin_chain_press.cpp.
// Layout: arrays of doubles with the batch of chains first; a group of chains fills the lanes of a vector, one group a
// piece. A chain alone runs in scalars.

#include "interface.h"
#include "parallel.h"
#include "skin_chain_press.h"
#include "workspace.h"

void fingerflow_press_skin(const fingerflow_skin_chain* given, int threads) {
    using namespace fingerflow;
    const SkinGroup group = FINGERFLOW_PICK(skin_group)(given->count, given->batch);
    const std::int64_t groups = (given->batch + group.chains - 1) / group.chains;
    parallel_for(groups, threads, [&](std::int64_t number) {
        void* const memory = workspace(static_cast<std::size_t>(group.bytes));
        FINGERFLOW_PICK(press_skin)(*given, number * group.chains, group.chains, memory);
    });
}
